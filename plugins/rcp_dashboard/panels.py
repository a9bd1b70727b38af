"""Panels of plugins: documents that the page shows in a frame without rights."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import msgspec
from litestar import get
from litestar.types import ASGIApp
from msgspec import Meta, Struct

from rcp_dashboard.files import File, answer
from rcp_kernel.errors import ConfigError
from rcp_web.application import Application, WebRequest, scope_of
from rcp_web.asgi import Headers

__all__ = ["PREFIX", "Panel", "Panels"]

PREFIX = "/dashboard/panels"
_MANIFEST = "panel.json"
_INDEX = "index.html"
_MOST = 5_000_000  # bytes of a document
_NAME = r"^[A-Za-z0-9_-]{1,64}$"
# The document has its scripts and styles within it: it comes from nowhere and connects to nowhere.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "font-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'self'; "
    "sandbox allow-scripts"
)
_HEADERS: Headers = [
    (b"content-security-policy", _POLICY.encode()),
    (b"referrer-policy", b"no-referrer"),
    (b"permissions-policy", b"camera=(), microphone=(), geolocation=(), payment=(), usb=()"),
]


class Port(Struct, frozen=True, forbid_unknown_fields=True):
    """Something that a panel reads or writes; a layout gives its path."""

    name: Annotated[str, Meta(pattern=_NAME)]
    description: Annotated[str, Meta(max_length=200)] = ""


class Panel(Struct, frozen=True, forbid_unknown_fields=True):
    """The file `panel.json`."""

    title: Annotated[str, Meta(min_length=1, max_length=100)]
    description: Annotated[str, Meta(max_length=500)] = ""
    reads: Annotated[tuple[Port, ...], Meta(max_length=16)] = ()
    writes: Annotated[tuple[Port, ...], Meta(max_length=16)] = ()


class Panels:
    """The panels of a configuration, served from memory."""

    def __init__(self, places: Mapping[str, str]) -> None:
        """Read the panels; each place is a folder, or a package that is installed.

        :raises ConfigError: names the panel that cannot be served, and why.
        """
        files: dict[str, File] = {}
        self.listed: dict[str, Panel] = {}
        for name, place in places.items():
            folder = _folder(name, place)
            self.listed[name] = _manifest(name, folder)
            files[f"{PREFIX}/{name}"] = File(_document(name, folder), _INDEX)

        @get([*files], sync_to_thread=False)
        def panel(request: WebRequest) -> ASGIApp:
            """Serve the document of a panel."""
            return answer(scope_of(request), files[request.scope["path"]], _HEADERS)

        self.app = Application([panel] if files else [], remedy="/dashboard/api/panels lists them.")

    def encoded(self) -> bytes:
        """Return the list of panels, as JSON."""
        panels = [
            {"name": name, **msgspec.to_builtins(panel)} for name, panel in self.listed.items()
        ]
        return msgspec.json.encode({"panels": panels})


def _folder(name: str, place: str) -> Path:
    if "/" in place:
        folder = Path(place)
    else:
        # The package is not imported: only two of its files are read.
        found = find_spec(place) if place.isidentifier() else None
        folders = list(found.submodule_search_locations or ()) if found is not None else []
        if not folders:
            raise _wrong(name, f"no package '{place}' is installed; install it, or name a folder")
        folder = Path(folders[0])
    return folder


def _manifest(name: str, folder: Path) -> Panel:
    try:
        return msgspec.json.decode((folder / _MANIFEST).read_bytes(), type=Panel)
    except FileNotFoundError:
        raise _wrong(name, f"{folder} has no {_MANIFEST}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise _wrong(name, f"{folder / _MANIFEST}: {error}") from None


def _document(name: str, folder: Path) -> bytes:
    found = folder / _INDEX
    if not found.is_file():
        raise _wrong(name, f"{folder} has no {_INDEX}")
    if found.stat().st_size > _MOST:
        raise _wrong(name, f"{found} has more than {_MOST} bytes")
    return found.read_bytes()


def _wrong(name: str, why: str) -> ConfigError:
    return ConfigError(f"[plugins.dashboard.panels] {name}: {why}")
