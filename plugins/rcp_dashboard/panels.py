"""Panels of plugins: folders of files that the page shows in a frame without rights."""

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
from rcp_web.application import Application, Asked, scope_of
from rcp_web.asgi import Headers

__all__ = ["PREFIX", "Panel", "Panels"]

PREFIX = "/dashboard/panels"
_MANIFEST = "panel.json"
_INDEX = "index.html"
_MOST = 5_000_000  # bytes of all files of one panel
_NAME = r"^[A-Za-z0-9_-]{1,64}$"
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; font-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'self'; sandbox allow-scripts"
)
_HEADERS: Headers = [
    (b"content-security-policy", _POLICY.encode()),
    (b"referrer-policy", b"no-referrer"),
    # The frame has an origin of its own that equals none: modules and fonts are fetched across it.
    (b"access-control-allow-origin", b"*"),
    # Beside the listener's `same-origin`: of two, none is in force (Fetch, 3.7). The files are public.
    (b"cross-origin-resource-policy", b"cross-origin"),
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
            for path, body in _read(name, folder).items():
                files[f"{PREFIX}/{name}/{path}"] = File.of(body, path)

        @get([*files], sync_to_thread=False)
        def panel(request: Asked) -> ASGIApp:
            """Serve a file of a panel."""
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
        # The package is not imported: only its files are served.
        found = find_spec(place) if place.isidentifier() else None
        folders = list(found.submodule_search_locations or ()) if found is not None else []
        if not folders:
            raise _wrong(name, f"no package '{place}' is installed; install it, or name a folder")
        folder = Path(folders[0])
    if not (folder / _INDEX).is_file():
        raise _wrong(name, f"{folder} has no {_INDEX}")
    return folder


def _manifest(name: str, folder: Path) -> Panel:
    try:
        return msgspec.json.decode((folder / _MANIFEST).read_bytes(), type=Panel)
    except FileNotFoundError:
        raise _wrong(name, f"{folder} has no {_MANIFEST}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise _wrong(name, f"{folder / _MANIFEST}: {error}") from None


def _read(name: str, folder: Path) -> dict[str, bytes]:
    """Read the files of a panel, without those of Python, hidden ones, and links that lead out."""
    found: dict[str, bytes] = {}
    left = _MOST
    root = folder.resolve()
    for path in sorted(folder.rglob("*")):
        inner = path.relative_to(folder)
        hidden = any(part.startswith((".", "__")) for part in inner.parts)
        if hidden or path.suffix in {".py", ".pyi", ".pyc"} or not path.is_file():
            continue
        if not path.resolve().is_relative_to(root):
            continue
        left -= path.stat().st_size
        if left < 0:
            raise _wrong(name, f"{folder} has more than {_MOST} bytes")
        found[inner.as_posix()] = path.read_bytes()
    return found


def _wrong(name: str, why: str) -> ConfigError:
    return ConfigError(f"[plugins.dashboard.panels] {name}: {why}")
