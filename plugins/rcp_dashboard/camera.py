"""Cameras: a single image, or a stream (multipart/x-mixed-replace) that always sends the newest."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import msgspec
from litestar.types import ASGIApp
from msgspec import Raw

from rcp_dashboard.config import DashboardConfig
from rcp_dashboard.picture import Picture, picture
from rcp_dashboard.request import DashboardRequest
from rcp_dashboard.watchers import checked
from rcp_gateway.api import Connection
from rcp_gateway.client_api import ClientApi
from rcp_kernel.clock import now, parse_time
from rcp_kernel.errors import QueueFull, RcpError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Request, encode_reply
from rcp_protocol.timeouts import timeout
from rcp_web.application import response
from rcp_web.asgi import Headers, Receive, Send, until_gone

__all__ = ["STALLED", "Cameras"]

STALLED = 30.0
"""s for which a client may stop reading; idle clients would block the limited streams."""
_NO_STORE = (b"cache-control", b"no-store")
_PART = b"--frame\r\ncontent-type: %b\r\ncontent-length: %d\r\nx-rcp-timestamp: %b\r\n\r\n%b\r\n"


class _Seen(msgspec.Struct):
    """The needed fields of a reply or an update."""

    type: str
    body: Any = None
    timestamp: str = ""
    source_timestamp: str = ""
    state: str = ""


_decode = msgspec.msgpack.Decoder(_Seen).decode


class Body(Protocol):
    """The listener's bypass of ASGI: `scope["extensions"]["rcp.stream"]`."""

    writable: bool
    drained: Callable[[], None] | None

    def write(self, data: bytes) -> None:
        """Send a part of the body."""
        ...

    def abort(self) -> None:
        """Close the connection at once."""
        ...


class Cameras:
    """Serves images."""

    def __init__(self, client_api: ClientApi, config: DashboardConfig) -> None:
        self._client_api = client_api
        self._config = config
        self._pool = ThreadPoolExecutor(2, "dashboard jpeg")
        self._streams = 0

    async def _picture(self, value: Any, quality: int) -> Picture:
        return await self._client_api.loop.run_in_executor(self._pool, picture, value, quality)

    async def snapshot(self, query: DashboardRequest) -> ASGIApp:
        """Return a response with the newest image; `x-rcp-age` is its age in s.

        :raises RcpError: the caller may not read it, or it is not an image.
        """
        quality = query.whole("quality", 1, 100, self._config.jpeg_quality)
        request = Request(type="read", path=query.path())
        reply = checked(await self._client_api.request(query.session, request))
        seen = _decode(encode_reply(reply, Encoding.MSGPACK))
        made = await self._picture(seen.body, quality)
        age = (now() - parse_time(seen.source_timestamp)) / 1e9
        headers: Headers = [
            _NO_STORE,
            (b"x-rcp-timestamp", seen.source_timestamp.encode()),
            (b"x-rcp-age", b"%.3f" % age),
            (b"x-rcp-state", seen.state.encode()),
        ]
        return response(200, made.data, made.media, headers)

    async def stream(self, query: DashboardRequest, receive: Receive, send: Send) -> None:
        """Send images until the client leaves or loses its rights.

        :raises RcpError: refused; nothing was sent.
        """
        quality = query.whole("quality", 1, 100, self._config.jpeg_quality)
        rate = query.number("rate", 0.01, 120)
        path = query.path()
        if self._streams >= self._config.streams:
            raise QueueFull(
                f"{self._streams} camera streams are already open",
                remedy="Close one, or ask the operator to raise [plugins.dashboard] streams.",
            )
        self._streams += 1
        stream = Stream(query, receive, send)
        try:
            connection = self._client_api.connect(
                query.principal,
                Encoding.MSGPACK,
                stream.wake,
                query.tenant,
                query.peer,
                one_way=True,
            )
            try:
                body: dict[str, Any] = {"qos": {"depth": 1}}
                if rate is not None:
                    body["rate"] = rate
                raw = Raw(msgspec.json.encode(body))
                request = Request(type="subscribe", path=path, id="camera", body=raw)
                checked(await self._client_api.request(connection.session, request))
                await stream.run(connection, lambda value: self._picture(value, quality))
            finally:
                connection.close()
        finally:
            self._streams -= 1

    def close(self) -> None:
        """Stop the threads."""
        self._pool.shutdown(wait=False, cancel_futures=True)


class Stream:
    """One endless response: the next image is collected once the last was sent, so none pile up."""

    def __init__(self, query: DashboardRequest, receive: Receive, send: Send) -> None:
        extensions = query.scope["extensions"]
        self._out: Body = extensions["rcp.stream"]
        self._closing: set[Callable[[], None]] = extensions["rcp.closing"]
        self._receive = receive
        self._send = send
        self._woken = asyncio.Event()
        self._ended = False
        self._taken: float | None = None
        """Since when the client has not been reading, by the loop's clock."""

    def wake(self) -> None:
        """Continue: there is an image, or room for one."""
        self._woken.set()

    def finish(self) -> None:
        """End the response."""
        self._ended = True
        self._woken.set()

    async def run(self, connection: Connection, make: Callable[[Any], Any]) -> None:
        """Send the images of the connection."""
        media = b"multipart/x-mixed-replace; boundary=frame"
        headers: Headers = [
            (b"content-type", media),
            _NO_STORE,
            (b"x-accel-buffering", b"no"),  # nginx would buffer images
        ]
        await self._send({"type": "http.response.start", "status": 200, "headers": headers})
        self._out.write(b"\r\n")  # sends the head, before there is an image
        self._out.drained = self.wake
        self._closing.add(self.finish)
        watch = asyncio.ensure_future(self._watch())
        try:
            while not self._ended and await self._moves():
                self._woken.clear()
                if self._out.writable:
                    await self._next(connection, make)
        finally:
            self._out.drained = None
            self._closing.discard(self.finish)
            watch.cancel()
        await self._send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _moves(self) -> bool:
        """Wait to be woken; return False after disconnecting a client that does not read."""
        now = asyncio.get_running_loop().time
        if self._out.writable:
            self._taken = None
            await self._woken.wait()
            return True
        self._taken = now() if self._taken is None else self._taken
        try:
            async with timeout(self._taken + STALLED - now()):
                await self._woken.wait()
        except TimeoutError:
            self._out.abort()
            return False
        return True

    async def _next(self, connection: Connection, make: Callable[[Any], Any]) -> None:
        newest: _Seen | None = None
        for data in connection.outbox.collect():
            seen = _decode(data)
            if seen.type == "update":
                newest = seen
        if newest is not None:
            try:
                made = await make(newest.body)
            except RcpError:
                self.finish()  # it will not become an image: the snapshot reports why
                return
            stamp = newest.timestamp.encode()
            if not self._ended:
                self._out.write(_PART % (made.media, len(made.data), stamp, made.data))
        if connection.outbox.more:
            self._woken.set()
        elif connection.expelled or not connection.session.subscriptions:
            self.finish()

    async def _watch(self) -> None:
        await until_gone(self._receive)
        self.finish()
