"""Files in memory, compressed where they were built so, with the headers of their kind."""

from __future__ import annotations

import asyncio
import gzip
import hashlib
import mimetypes
import re
from typing import Any

from litestar.types import ASGIApp

from rcp_web.application import response
from rcp_web.asgi import Headers, Scope, header, respond

__all__ = ["File", "answer"]

_FOREVER = (b"cache-control", b"public, max-age=31536000, immutable")
_REVALIDATE = (b"cache-control", b"no-cache")
_VARY = (b"vary", b"accept-encoding")
_GZIP = (b"content-encoding", b"gzip")


class File:
    """One file, with its headers."""

    def __init__(self, content: bytes, name: str, *, packed: bool = False) -> None:
        """Initialise with what a file of this name holds; `packed`: compressed with gzip."""
        media = mimetypes.guess_type(name)[0] or "application/octet-stream"
        if media.startswith("text/") or name.endswith((".js", ".json", ".svg")):
            media += "; charset=utf-8"
        self.media = media.encode()
        # Weak: one for both forms, which say the same.
        self.etag = b'W/"%s"' % hashlib.sha256(content).hexdigest()[:20].encode()
        self.cache = _FOREVER if name.startswith("/assets/") else _REVALIDATE
        self.packed = content if packed else None
        self._plain = None if packed else content
        self._unpacking = asyncio.Lock()

    async def plain(self) -> bytes:
        """Return the content itself, for the few clients that take no gzip; it is kept.

        So all of them together cost the time and memory of one copy. A thread unpacks it: a
        megabyte takes milliseconds in which no robot would be answered.
        """
        if self._plain is None:
            async with self._unpacking:
                if self._plain is None:
                    assert self.packed is not None
                    self._plain = await asyncio.to_thread(gzip.decompress, self.packed)
        return self._plain


def answer(scope: Scope, file: File, safe: Headers) -> ASGIApp:
    """Answer with a file and these headers; without its content to who has it already."""
    root = scope.get("root_path", "").encode()
    if root and scope["raw_path"] == root:  # relative links would resolve one level too high
        return response(308, headers=[(b"location", root + b"/"), *safe])
    headers = [*safe, file.cache, _VARY, (b"etag", file.etag)]
    known = header(scope, b"if-none-match") or b""
    if any(_same(part.strip(), file.etag) for part in known.split(b",")):
        return response(304, headers=headers)
    if file.packed is not None and _takes_gzip(header(scope, b"accept-encoding") or b""):
        return response(200, file.packed, file.media, [*headers, _GZIP])
    return _unpacked(file, headers)


def _unpacked(file: File, headers: Headers) -> ASGIApp:
    async def send_it(_scope: object, _receive: object, send: Any) -> None:
        await respond(send, 200, await file.plain(), file.media, headers)

    return send_it


def _same(named: bytes, etag: bytes) -> bool:
    return named == b"*" or named.removeprefix(b"W/") == etag.removeprefix(b"W/")


def _takes_gzip(accepted: bytes) -> bool:
    for part in accepted.lower().split(b","):
        name, *options = (text.strip() for text in part.split(b";"))
        if name == b"gzip":
            return not any(re.fullmatch(rb"q=0(\.0*)?", option) for option in options)
    return False
