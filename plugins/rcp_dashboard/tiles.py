"""The tiles below the map: a PMTiles archive, of which the page asks for ranges."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncGenerator
from contextlib import ExitStack, aclosing
from io import FileIO
from pathlib import Path
from typing import Any

import msgspec
from litestar import get
from litestar.types import ASGIApp

from rcp_kernel.errors import ConfigError, RcpError, UnknownPath
from rcp_protocol.timeouts import timeout
from rcp_web.application import Application, WebRequest, response, scope_of
from rcp_web.asgi import Headers, Scope, header, until_gone
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
        async def tiles(request: WebRequest) -> ASGIApp:
            """Answer with the archive, or a range of it."""
            return await self._send(scope_of(request))

        self.app = Application([facts, tiles], refuse=_refuse, remedy=f"{PREFIX} tells of tiles.")

    async def _send(self, scope: Scope) -> ASGIApp:
        if self._archive is None:
            raise _nothing("no tiles are configured")
        try:
            file = await _open(self._archive)
        except OSError as error:
            raise _nothing(f"the archive of tiles cannot be read: {error.strerror}") from error
        with ExitStack() as undo:
            undo.callback(file.close)
            answer = _answer(scope, file)
            undo.pop_all()  # whoever answers closes it
        return answer


def _answer(scope: Scope, file: FileIO) -> ASGIApp:
    there = os.fstat(file.fileno())  # of what is read, whatever lies at its path by now
    etag = b'"%x-%x"' % (there.st_mtime_ns, there.st_size)
    headers: Headers = [
        (b"accept-ranges", b"bytes"),
        (b"cache-control", b"no-cache"),
        (b"etag", etag),
    ]
    if etag in (header(scope, b"if-none-match") or b""):
        file.close()
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
    return _streamed(status, headers, file, start, stop)


def _streamed(status: int, headers: Headers, file: FileIO, start: int, stop: int) -> ASGIApp:
    async def send_it(_scope: Any, receive: Any, send: Any) -> None:
        with file:
            await send({"type": "http.response.start", "status": status, "headers": headers})
            gone = asyncio.ensure_future(until_gone(receive))
            try:
                async with aclosing(_pieces(file, start, stop)) as pieces:
                    async for piece in pieces:
                        if gone.done():  # a listener takes what nobody reads, as fast as it comes
                            return
                        async with timeout(_STALLED):
                            body = {"type": "http.response.body", "body": piece, "more_body": True}
                            await send(body)
            finally:
                gone.cancel()
        await send({"type": "http.response.body", "body": b""})

    return send_it


async def _pieces(file: FileIO, start: int, stop: int) -> AsyncGenerator[bytes]:
    while start < stop:
        piece = await _read(file, min(_PIECE, stop - start), start)
        if not piece:  # it was cut short meanwhile: the client sees that the answer is too
            return
        start += len(piece)
        yield piece


async def _open(archive: Path) -> FileIO:
    opening = asyncio.ensure_future(asyncio.to_thread(FileIO, archive))
    try:
        return await asyncio.shield(opening)
    except asyncio.CancelledError:
        opening.add_done_callback(_close)
        raise


def _close(opening: asyncio.Future[FileIO]) -> None:
    if not opening.cancelled() and opening.exception() is None:
        opening.result().close()


async def _read(file: FileIO, size: int, start: int) -> bytes:
    """Read in a thread, and wait for it when cancelled too: no file is closed that is read."""
    reading = asyncio.ensure_future(asyncio.to_thread(os.pread, file.fileno(), size, start))
    try:
        return await asyncio.shield(reading)
    except asyncio.CancelledError:
        await asyncio.wait([reading])
        raise


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
