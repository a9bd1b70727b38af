"""One endless response: woken when there is something to say, written only when it is taken."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

from rcp_kernel.asgi import Receive, Scope, Send

__all__ = ["Stream"]

_HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"cache-control", b"no-store"),
    (b"x-accel-buffering", b"no"),  # nginx would hold events back
]
_COMMENT = b":\n\n"


class Flow(Protocol):
    """The listener's view of the socket: `scope["extensions"]["rcp.flow"]`."""

    write_paused: bool

    async def drain(self) -> None:
        """Wait until the write buffer has room."""
        ...


class Stream:
    """The response of one client."""

    def __init__(self, scope: Scope, receive: Receive, send: Send, comment: float) -> None:
        self._receive = receive
        self._send = send
        self._comment = comment
        extensions = scope.get("extensions", {})
        self._flow: Flow | None = extensions.get("rcp.flow")
        self._closing: set[Callable[[], None]] = extensions.get("rcp.closing", set())
        self._waiter: asyncio.Future[None] | None = None
        self._woken = False
        self._idle = False
        self.over = False
        """The client is gone, or the listener closes."""

    def wake(self) -> None:
        """Have `run` look for something to say."""
        self._woken = True
        waiter = self._waiter
        if waiter is not None and not waiter.done():
            waiter.set_result(None)

    def finish(self) -> None:
        """End the response."""
        self.over = True
        self.wake()

    async def run(self, collect: Callable[[], tuple[list[bytes], bool]]) -> None:
        """Send what `collect` returns whenever woken, until it says that this was all."""
        loop = asyncio.get_running_loop()
        await self._send({"type": "http.response.start", "status": 200, "headers": _HEADERS})
        watch = asyncio.ensure_future(self._watch())
        self._closing.add(self.finish)
        timer = loop.call_later(self._comment, self._tick)
        self.wake()  # the head has to go out, and there may be something already
        try:
            await self._body(b":ok\n\n")
            while not self.over:
                await self._pause(loop)
                chunks, more = collect()
                if self._idle:
                    self._idle = False
                    timer = loop.call_later(self._comment, self._tick)
                    chunks.append(_COMMENT)
                if chunks:
                    await self._body(b"".join(chunks))
                if not more:
                    break
        finally:
            timer.cancel()
            self._closing.discard(self.finish)
            watch.cancel()
        await self._send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _pause(self, loop: asyncio.AbstractEventLoop) -> None:
        """Wait to be woken, then until the socket takes something: what waits goes on conflating."""
        if not self._woken:
            self._waiter = loop.create_future()
            await self._waiter
            self._waiter = None
        flow = self._flow
        if flow is not None and flow.write_paused:
            await flow.drain()
        self._woken = False

    async def _body(self, data: bytes) -> None:
        await self._send({"type": "http.response.body", "body": data, "more_body": True})

    def _tick(self) -> None:
        self._idle = True
        self.wake()

    async def _watch(self) -> None:
        """Take notice of the client's leaving."""
        while True:
            message: Any = await self._receive()
            if message["type"] == "http.disconnect":
                self.finish()
                return
