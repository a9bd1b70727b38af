"""From an HTTP request to an open WebSocket, with the ASGI application in between.

The handshake is checked and answered here; once the application accepts, picows' protocol takes the
transport over and calls `Socket`. An application that takes the native handle from
`scope["extensions"]["rcp.socket"]` no longer uses ASGI; others use `receive` and `send`.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
from collections import deque
from typing import Any

import structlog
from picows import WSUpgradeRequest, WSUpgradeResponse, WSUpgradeResponseWithListener
from uvicorn.protocols.http.httptools_impl import STATUS_LINE
from uvicorn.server import ServerState

from rcp_asgi.connection_limiter import Seat
from rcp_asgi.deflate import accept_offer
from rcp_asgi.frame_reader import FrameReader
from rcp_asgi.origins import is_loopback
from rcp_asgi.settings import Settings
from rcp_asgi.socket import Socket
from rcp_gateway.client_api import Asgi
from rcp_kernel.errors import BadRequest, InternalError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_reply, failure
from rcp_web.asgi import Scope

__all__ = ["Upgrade"]

log = structlog.get_logger("rcp.asgi")
_QUEUE = 64  # messages that an ASGI application may leave unread before reading pauses
_GOING_AWAY = 1001
_BINARY = ("rcp.v1.cbor", "rcp.v1.msgpack", "foxglove.sdk.v1", "foxglove.websocket.v1")
"""Subprotocols of data that compression costs more than it saves."""


class Upgrade(asyncio.Protocol):
    """One WebSocket connection, from its handshake on."""

    def __init__(
        self,
        scope: Scope,
        transport: asyncio.Transport,
        app: Asgi,
        *,
        settings: Settings,
        seat: Seat,
        state: ServerState,
        loop: asyncio.AbstractEventLoop,
        rest: bytes,
    ) -> None:
        self._scope = scope
        self._transport = transport
        self._app = app
        self._settings = settings
        self._seat = seat
        self._state = state
        self._loop = loop
        self._rest = rest
        self._headers = dict(scope["headers"])
        self._key = self._headers.get(b"sec-websocket-key", b"")
        self._stage = "connecting"  # → accepted | denied | closed
        self._denial: tuple[int, list[tuple[bytes, bytes]]] = (403, [])
        self._events: deque[dict[str, Any]] = deque([{"type": "websocket.connect"}])
        self._arrived = asyncio.Event()
        self._arrived.set()
        self._drained = asyncio.Event()
        self._drained.set()
        self.socket = Socket(settings, self, loop)

    def begin(self) -> None:
        """Check the handshake and call the application."""
        self._transport.pause_reading()
        self._transport.set_protocol(self)
        self._state.connections.add(self)  # type: ignore[arg-type] - it only needs `shutdown`
        problem = self._problem()
        if problem is not None:
            status, text = problem
            self._deny(status, _envelope(BadRequest(text)), [(b"sec-websocket-version", b"13")])
            return
        self._scope["subprotocols"] = self._offered()
        self._scope["extensions"] = {
            "websocket.http.response": {},
            "rcp.socket": self.socket,
            "rcp.closing": self._settings.closing,
            "rcp.peer": self._scope["extensions"]["rcp.peer"],
        }
        task = self._loop.create_task(self._run())
        self._state.tasks.add(task)
        task.add_done_callback(self._state.tasks.discard)

    def _problem(self) -> tuple[int, str] | None:
        if self._scope["method"] != "GET":
            return 400, "a WebSocket handshake must use GET"
        if self._scope["http_version"] != "1.1":
            return 400, "a WebSocket handshake must use HTTP/1.1"
        length = self._headers.get(b"content-length", b"0")
        if length.strip(b"0") or b"transfer-encoding" in self._headers:
            return 400, "a WebSocket handshake must not have a body"
        if self._headers.get(b"sec-websocket-version") != b"13":
            return 426, "only WebSocket version 13 is supported"
        try:
            good = len(base64.b64decode(self._key, validate=True)) == 16
        except (binascii.Error, ValueError):
            good = False
        return None if good else (400, "the Sec-WebSocket-Key is invalid")

    def _offered(self) -> list[str]:
        found: list[str] = []
        for name, value in self._scope["headers"]:
            if name == b"sec-websocket-protocol":
                found += [part.strip() for part in value.decode("latin-1").split(",")]
        return [name for name in found if name]

    async def _run(self) -> None:
        try:
            await self._app(self._scope, self._receive, self._send)
        except Exception:
            log.exception("websocket_failed", path=self._scope["path"])
            if self._stage == "connecting":
                self._deny(500, _envelope(InternalError("the gateway failed; see its log")), [])
            else:
                self.socket.close(1011, "the gateway failed")
        else:
            if self._stage == "connecting":
                self._deny(403, b"", [])
            else:
                self.socket.close(1000)

    # -- ASGI ----------------------------------------------------------------------------------

    async def _receive(self) -> dict[str, Any]:
        while not self._events:
            self._arrived.clear()
            await self._arrived.wait()
        event = self._events.popleft()
        if len(self._events) < _QUEUE // 2:
            self.socket.resume_reading()
        return event

    async def _send(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if self._stage == "closed":
            return
        if self._stage == "connecting":
            self._answer(kind, message)
        elif kind == "websocket.send":
            await self._drained.wait()
            text = message.get("text")
            data = message.get("bytes") if text is None else text.encode()
            self.socket.send(data or b"", text=text is not None)
        elif kind == "websocket.close":
            self.socket.close(message.get("code", 1000), message.get("reason") or "")
        elif not (kind == "websocket.http.response.body" and self._stage == "denied"):
            raise RuntimeError(f"'{kind}' does not follow an accepted WebSocket")

    def _answer(self, kind: str, message: dict[str, Any]) -> None:
        if kind == "websocket.accept":
            self._accept(message.get("subprotocol"), message.get("headers", ()))
        elif kind == "websocket.http.response.start":
            self._denial = (message["status"], list(message.get("headers", ())))
        elif kind == "websocket.http.response.body":
            self._deny(self._denial[0], message.get("body", b""), self._denial[1])
        elif kind == "websocket.close":
            self._deny(403, b"", [])
        else:
            raise RuntimeError(f"'{kind}' came before 'websocket.accept'")

    # -- handshake -----------------------------------------------------------------------------

    def _accept(self, subprotocol: str | None, headers: Any) -> None:
        if self._transport.is_closing():
            return  # `connection_lost` is about to be called
        fields = [(name.decode("latin-1"), value.decode("latin-1")) for name, value in headers]
        if subprotocol is not None:
            fields.append(("Sec-WebSocket-Protocol", subprotocol))
        agreed = self._agree_on_deflate(subprotocol)
        if agreed is not None:
            fields.append(("Sec-WebSocket-Extensions", agreed))
        fields += [(k.decode(), v.decode()) for k, v in self._state.default_headers]

        def listen(_: WSUpgradeRequest) -> WSUpgradeResponseWithListener:
            response = WSUpgradeResponse.create_101_response(fields)
            return WSUpgradeResponseWithListener(response, self.socket)

        # Twice the limit is read, so that the sender gets an error and keeps the connection.
        protocol = FrameReader(listen, 2 * self._settings.client_api.limits.message)
        self._stage = "accepted"
        protocol.connection_made(self._transport)
        protocol.feed(_REQUEST % self._key)
        self._transport.set_protocol(protocol)
        if self._rest:
            protocol.feed(self._rest)
            self._rest = b""
        if self.socket.reading:  # unless the first data has paused it
            self._transport.resume_reading()

    def _agree_on_deflate(self, subprotocol: str | None) -> str | None:
        wish = self._settings.config.compression
        if wish == "never" or (wish == "auto" and subprotocol in _BINARY):
            return None
        offers = [v for k, v in self._scope["headers"] if k == b"sec-websocket-extensions"]
        agreed = accept_offer(b",".join(offers).decode("latin-1"))
        if agreed is None:
            return None
        client = self._scope["client"]
        near = client is None or is_loopback(client[0])
        self.socket.deflates = True
        self.socket.compresses = wish == "always" or not near
        return agreed

    def _deny(self, status: int, body: bytes, headers: list[tuple[bytes, bytes]]) -> None:
        self._stage = "denied"
        if self._transport.is_closing():
            return
        kept = [(k, v) for k, v in headers if k not in (b"content-length", b"connection")]
        if body and not any(k == b"content-type" for k, _ in kept):
            kept.append((b"content-type", b"application/json"))
        kept += [(b"content-length", b"%d" % len(body)), (b"connection", b"close")]
        lines = b"".join(b"%b: %b\r\n" % pair for pair in kept)
        self._transport.write(STATUS_LINE[status] + lines + b"\r\n" + body)
        self._transport.close()

    # -- asyncio, until picows has taken over --------------------------------------------------

    def connection_lost(self, exc: Exception | None) -> None:
        """Notify the user of the socket that the client is gone."""
        self.socket.end()

    def shutdown(self) -> None:
        """Close, because the listener stops."""
        if self._stage == "connecting":
            self._deny(503, b"", [])
        else:
            self.socket.close(_GOING_AWAY, "the gateway is closing")

    # -- Receiver, for applications that use ASGI ----------------------------------------------

    def _push(self, event: dict[str, Any]) -> None:
        self._events.append(event)
        self._arrived.set()

    def received(self, data: bytes, text: bool) -> None:  # noqa: FBT001 - see Receiver
        """Queue a message until the application reads it."""
        value = {"text": data.decode()} if text else {"bytes": data}
        self._push({"type": "websocket.receive", **value})
        if len(self._events) >= _QUEUE:
            self.socket.pause_reading()

    def settled(self) -> None:
        """Do nothing: the application reads at its own pace."""

    def other_frame(self) -> None:
        """Do nothing."""

    def garbled(self, data: bytes) -> None:
        """Do nothing: the close code reports it."""

    def oversized(self, size: int) -> None:
        """Close: ASGI has no other way to report it."""
        self.socket.close(1009, "the message is too long")

    def drained(self) -> None:
        """Let the application send again."""
        self._drained.set()

    def lost(self, code: int) -> None:
        """Notify the application."""
        self._state.connections.discard(self)  # type: ignore[arg-type]
        self._seat.leave()
        self._stage = "closed"
        self._push({"type": "websocket.disconnect", "code": code})
        self._drained.set()


_REQUEST = (
    b"GET / HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: %b\r\n\r\n"
)
"""A constant request for picows, because the real one was checked already."""


def _envelope(error: BadRequest | InternalError) -> bytes:
    return encode_reply(failure(error, "error"), Encoding.JSON)
