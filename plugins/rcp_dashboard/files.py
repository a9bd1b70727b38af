"""Files in memory, with the headers of their kind."""

from __future__ import annotations

import hashlib
import mimetypes
import re

import msgspec
from litestar.types import ASGIApp

from rcp_web.application import response
from rcp_web.asgi import Headers, Scope, header

__all__ = ["File", "answer"]

_FOREVER = (b"cache-control", b"public, max-age=31536000, immutable")
_REVALIDATE = (b"cache-control", b"no-cache")
_VARY = (b"vary", b"accept-encoding")


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


def answer(scope: Scope, file: File, safe: Headers) -> ASGIApp:
    """Answer with a file and these headers; without its content to who has it already."""
    root = scope.get("root_path", "").encode()
    if root and scope["raw_path"] == root:  # relative links would resolve one level too high
        return response(308, headers=[(b"location", root + b"/"), *safe])
    headers = [*safe, file.cache, _VARY, (b"etag", file.etag)]
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
