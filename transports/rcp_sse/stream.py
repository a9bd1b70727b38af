"""One endless response: woken when there is data, written only when the socket is writable."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Protocol

import structlog

from rcp_web.asgi import Receive, Scope, Send, until_gone

__all__ = ["Collect", "Stream"]

log = structlog.get_logger("rcp.sse")
_HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"cache-control", b"no-store"),
    (b"x-accel-buffering", b"no"),  # nginx would buffer events
]
_COMMENT = b":\n\n"
Collect = Callable[[], list[bytes]]
"""Return the data to send now."""


class Body(Protocol):
    """The listener's bypass of ASGI: `scope["extensions"]["rcp.stream"]`."""

    writable: bool
    """Whether the socket accepts data."""
    drained: Callable[[], None] | None
    """Called when `writable` becomes true again."""

    def write(self, data: bytes) -> None:
        """Send a part of the body."""
        ...


class Stream:
    """The response of one client."""

    def __init__(self, scope: Scope, receive: Receive, send: Send, comment: float) -> None:
        self._receive = receive
        self._send = send
        self._period = comment
        extensions = scope["extensions"]
        self._out: Body = extensions["rcp.stream"]
        self._closing: set[Callable[[], None]] = extensions["rcp.closing"]
        self._collect: Collect | None = None
        self._ended = asyncio.get_running_loop().create_future()
        self._comment = False
        self.last = False
        """Whether the next data is the last."""

    def wake(self) -> None:
        """Send pending data if the socket accepts it; otherwise it keeps conflating."""
        collect = self._collect
        if collect is None or not self._out.writable:
            return
        try:
            chunks = collect()
        except Exception:
            # The error belongs to this response only: the client reconnects and resumes.
            log.exception("stream_failed")
            self.finish()
            return
        if self._comment:
            self._comment = False
            chunks.append(_COMMENT)
        if chunks:
            self._out.write(chunks[0] if len(chunks) == 1 else b"".join(chunks))
        if self.last:
            self.finish()

    def finish(self) -> None:
        """End the response."""
        self._collect = None
        if not self._ended.done():
            self._ended.set_result(None)

    async def run(self, collect: Collect) -> None:
        """Send what `collect` returns whenever woken, until `last` or `finish`."""
        await self._send({"type": "http.response.start", "status": 200, "headers": _HEADERS})
        self._out.write(b":ok\n\n")  # sends the head, so that `EventSource` opens
        self._out.drained = self.wake
        self._collect = collect
        self._closing.add(self.finish)
        watch = asyncio.ensure_future(self._watch())
        ticking = asyncio.ensure_future(self._tick())
        try:
            self.wake()
            await self._ended
        finally:
            self._collect = None
            self._out.drained = None
            self._closing.discard(self.finish)
            watch.cancel()
            ticking.cancel()
        await self._send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _tick(self) -> None:
        """Send a comment, which keeps proxies from closing and detects clients that are gone."""
        while True:
            await asyncio.sleep(self._period)
            self._comment = True
            self.wake()

    async def _watch(self) -> None:
        await until_gone(self._receive)
        self.finish()
