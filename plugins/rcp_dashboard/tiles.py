"""The tiles below the map: a PMTiles archive, of which the page asks for ranges."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncGenerator
from contextlib import aclosing
from pathlib import Path
from typing import Any

import msgspec
from litestar import get
from litestar.types import ASGIApp

from rcp_kernel.errors import ConfigError, RcpError, UnknownPath
from rcp_web.application import Application, Asked, response, scope_of
from rcp_web.asgi import Headers, Scope, header
from rcp_web.ranges import byte_range, range_headers
from rcp_web.refusals import Refusal, envelope

__all__ = ["PREFIX", "Tiles"]

PREFIX = "/dashboard/map"
_ARCHIVE = f"{PREFIX}/tiles"
_MAGIC = b"PMTiles\x03"
_PIECE = 262_144  # bytes that are read at a time
_STALLED = 60.0  # s that a client may take no bytes
_MEDIA = b"application/vnd.pmtiles"


class Tiles:
    """The archive of a configuration; it may be replaced while the gateway runs."""

    def __init__(self, archive: str | None) -> None:
        """Take the path of the archive, if there is one.

        :raises ConfigError: it cannot be read, or is no PMTiles archive of version 3.
        """
        self._archive = Path(archive) if archive else None
        if self._archive is not None:
            _check(self._archive)
        known = msgspec.json.encode({"tiles": self._archive is not None})

        @get(PREFIX, sync_to_thread=False)
        def facts() -> ASGIApp:
            """Tell whether there are tiles."""
            return response(200, known, headers=[(b"cache-control", b"no-cache")])

        @get(_ARCHIVE)
        async def tiles(request: Asked) -> ASGIApp:
            """Answer with the archive, or a range of it."""
            return await self._send(scope_of(request))

        self.app = Application([facts, tiles], refuse=_refuse, remedy=f"{PREFIX} tells of tiles.")

    async def _send(self, scope: Scope) -> ASGIApp:
        if self._archive is None:
            raise _nothing("no tiles are configured")
        try:
            there = await asyncio.to_thread(os.stat, self._archive)
        except OSError as error:
            raise _nothing(f"the archive of tiles cannot be read: {error.strerror}") from error
        etag = b'"%x-%x"' % (there.st_mtime_ns, there.st_size)
        headers: Headers = [
            (b"accept-ranges", b"bytes"),
            (b"cache-control", b"no-cache"),
            (b"etag", etag),
        ]
        if etag in (header(scope, b"if-none-match") or b""):
            return response(304, headers=headers)
        start, stop, status = 0, there.st_size, 200
        wanted = header(scope, b"range")
        if wanted is not None and (header(scope, b"if-range") or etag) == etag:
            part = byte_range(wanted.decode("latin-1"), there.st_size)
            if part is not None:
                (start, stop), status = part, 206
                place = b"bytes %d-%d/%d" % (start, stop - 1, there.st_size)
                headers.append((b"content-range", place))
        headers += [(b"content-type", _MEDIA), (b"content-length", b"%d" % (stop - start))]
        if scope["method"] == "HEAD":
            start = stop  # nothing is read for it
        return _streamed(status, headers, self._archive, start, stop)


def _streamed(status: int, headers: Headers, archive: Path, start: int, stop: int) -> ASGIApp:
    async def send_it(_scope: Any, _receive: Any, send: Any) -> None:
        async with aclosing(_pieces(archive, start, stop)) as pieces:
            await send({"type": "http.response.start", "status": status, "headers": headers})
            async for piece in pieces:
                async with asyncio.timeout(_STALLED):
                    await send({"type": "http.response.body", "body": piece, "more_body": True})
        await send({"type": "http.response.body", "body": b""})

    return send_it


async def _pieces(archive: Path, start: int, stop: int) -> AsyncGenerator[bytes]:
    file = await asyncio.to_thread(os.open, archive, os.O_RDONLY)
    try:
        while start < stop:
            piece = await asyncio.to_thread(os.pread, file, min(_PIECE, stop - start), start)
            if not piece:  # it was cut short meanwhile: the client sees that the answer is too
                return
            start += len(piece)
            yield piece
    finally:
        os.close(file)


def _check(archive: Path) -> None:
    try:
        with archive.open("rb") as file:
            begin = file.read(len(_MAGIC))
    except OSError as error:
        raise _wrong(f"{archive} cannot be read: {error.strerror}") from None
    if begin != _MAGIC:
        raise _wrong(f"{archive} is no PMTiles archive of version 3")


def _wrong(why: str) -> ConfigError:
    return ConfigError(f"[plugins.dashboard] tiles: {why}")


def _nothing(why: str) -> UnknownPath:
    return UnknownPath(why, remedy="Name a PMTiles archive in [plugins.dashboard] tiles.")


def _refuse(scope: Scope, error: RcpError) -> Refusal:
    return envelope(scope, error)._replace(headers=tuple(range_headers(error)))
