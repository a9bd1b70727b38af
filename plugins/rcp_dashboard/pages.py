"""The built pages, served from memory; files with a hash in their name are cached forever."""

from __future__ import annotations

import hashlib
import mimetypes
import re
from pathlib import Path
from typing import Any

import msgspec
import structlog
from litestar import get
from litestar.types import ASGIApp

from rcp_web.application import Application, Asked, response, scope_of
from rcp_web.asgi import Headers, Scope, header

__all__ = ["STATIC", "Pages"]

log = structlog.get_logger("rcp.dashboard")
STATIC = Path(__file__).with_name("static")
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "font-src 'self'; connect-src 'self'; worker-src 'self'; manifest-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_SAFE: Headers = [
    (b"content-security-policy", _POLICY.encode()),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"permissions-policy", b"camera=(), microphone=(), geolocation=(), payment=(), usb=()"),
]
_FOREVER = (b"cache-control", b"public, max-age=31536000, immutable")
_REVALIDATE = (b"cache-control", b"no-cache")
_VARY = (b"vary", b"accept-encoding")
_UNBUILT = b"""<!doctype html><html lang="en"><meta charset="utf-8"><title>RCP gateway</title>
<h1>RCP gateway</h1>
<p>The gateway runs; the pages of its dashboard are not part of this installation.</p>
<p>In a clone, <code>make dashboard</code> builds them (it fetches packages with npm); a wheel made
without <code>RCP_DASHBOARD=off</code> has them. Then start the gateway again.</p>
<p>Everything else is at <a href="rcp/v1">/rcp/v1</a>.</p></html>
"""


class File(msgspec.Struct, frozen=True):
    """One file, with its headers."""

    body: bytes
    packed: bytes | None
    """The content, compressed with gzip at build time."""
    media: bytes
    etag: bytes
    cache: tuple[bytes, bytes]

    @classmethod
    def of(cls, body: bytes, name: str, packed: bytes | None = None) -> File:
        """Build the entry of a file name."""
        media = mimetypes.guess_type(name)[0] or "application/octet-stream"
        if media.startswith("text/") or name.endswith((".js", ".json", ".svg")):
            media += "; charset=utf-8"
        etag = b'W/"%s"' % hashlib.sha256(body).hexdigest()[:20].encode()
        cache = _FOREVER if name.startswith("/assets/") else _REVALIDATE
        return cls(body, packed, media.encode(), etag, cache)


class Pages:
    """The files by path, each a route of the application."""

    def __init__(self, static: Path) -> None:
        files = dict(_load(static))
        self.built = "/index.html" in files
        """Whether the pages were built."""
        if not self.built:
            log.warning("dashboard_not_built", remedy="make dashboard")
        files["/"] = files.pop("/index.html", None) or File.of(_UNBUILT, "/index.html")

        @get([*files], sync_to_thread=False)
        def page(request: Asked) -> ASGIApp:
            """Serve a file."""
            return _answer(scope_of(request), files[request.scope["path"]])

        self.app = Application([page], remedy="The dashboard is at `/`.")

    def facts(self) -> dict[str, Any]:
        """Return the part of `/system/status`."""
        return {} if self.built else {"detail": "the pages were not built: run `make dashboard`"}


def _answer(scope: Scope, file: File) -> ASGIApp:
    root = scope.get("root_path", "").encode()
    if root and scope["raw_path"] == root:  # relative links would resolve one level too high
        return response(308, headers=[(b"location", root + b"/"), *_SAFE])
    headers = [*_SAFE, file.cache, _VARY, (b"etag", file.etag)]
    known = header(scope, b"if-none-match") or b""
    if any(_same(part.strip(), file.etag) for part in known.split(b",")):
        return response(304, headers=headers)
    body = file.body
    if file.packed is not None and _takes_gzip(header(scope, b"accept-encoding") or b""):
        body = file.packed
        headers.append((b"content-encoding", b"gzip"))
    return response(200, body, file.media, headers)


def _same(named: bytes, etag: bytes) -> bool:
    return named == b"*" or named.removeprefix(b"W/") == etag.removeprefix(b"W/")


def _takes_gzip(accepted: bytes) -> bool:
    for part in accepted.lower().split(b","):
        name, *options = (text.strip() for text in part.split(b";"))
        if name == b"gzip":
            return not any(re.fullmatch(rb"q=0(\.0*)?", option) for option in options)
    return False


def _load(static: Path) -> list[tuple[str, File]]:
    found: list[tuple[str, File]] = []
    for path in static.rglob("*"):
        if not path.is_file() or path.suffix == ".gz":
            continue
        name = "/" + path.relative_to(static).as_posix()
        packed = path.with_name(path.name + ".gz")
        body = packed.read_bytes() if packed.is_file() else None
        found.append((name, File.of(path.read_bytes(), name, body)))
    return found
