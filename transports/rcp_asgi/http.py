"""HTTP framing: uvicorn's httptools protocol, with limits on headers, time and connections.

What is malformed is answered with an envelope here too, and a WebSocket handshake goes to
`Upgrade` without being written out and parsed again.
"""

from __future__ import annotations

import asyncio
from typing import Any, cast
from urllib.parse import unquote

import httptools
from uvicorn.config import Config
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol
from uvicorn.server import ServerState

from rcp_asgi.endless import Endless
from rcp_asgi.settings import Settings
from rcp_asgi.upgrade import Upgrade
from rcp_kernel.door import Asgi
from rcp_kernel.errors import BadRequest, PayloadTooLarge, QueueFull, RcpError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_reply, failure

__all__ = ["HttpProtocol"]


class HttpProtocol(HttpToolsProtocol):
    """One HTTP connection."""

    def __init__(
        self,
        *,
        settings: Settings,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._settings = settings
        self._head = 0
        self._in_head = True
        self._slow: asyncio.TimerHandle | None = None
        self._extensions: dict[str, Any] = {}
        self._body: Endless | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, unless there are too many."""
        super().connection_made(transport)
        self._body = Endless(transport)
        self._extensions = {"rcp.stream": self._body, "rcp.closing": self._settings.closing}
        settings = self._settings.config
        if len(self.connections) > settings.connections:
            error = QueueFull(f"{settings.connections} connections are open already")
            self._give_up(error, error.http)
            return
        self._slow = self.loop.call_later(settings.header_timeout, transport.close)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the clock."""
        self._stop_clock()
        if self._body is not None:
            self._body.writable = False
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """Hold an endless response back."""
        super().pause_writing()
        if self._body is not None:
            self._body.writable = False

    def resume_writing(self) -> None:
        """Go on with an endless response."""
        super().resume_writing()
        if self._body is not None:
            self._body.resume()

    def _stop_clock(self) -> None:
        if self._slow is not None:
            self._slow.cancel()
            self._slow = None

    def data_received(self, data: bytes) -> None:
        """Parse; what is no HTTP is told so and cut."""
        self._unset_keepalive_if_required()
        try:
            self.parser.feed_data(data)  # pyright: ignore[reportOptionalMemberAccess] - None once lost
        except httptools.HttpParserUpgrade as upgrade:
            if self._should_upgrade():
                self._upgrade(data[upgrade.args[0] :])
        except httptools.HttpParserError:
            if self._head > self._settings.config.max_header:
                self._give_up(PayloadTooLarge("the request's headers are too long"), 431)
            else:
                self._give_up(BadRequest("this is not HTTP/1.1"), 400)
        else:
            if self._in_head and self._slow is None:
                delay = self._settings.config.header_timeout
                self._slow = self.loop.call_later(delay, self.transport.close)

    def on_message_begin(self) -> None:
        """Begin to count what the headers take."""
        super().on_message_begin()
        self.scope["extensions"] = self._extensions  # type: ignore[typeddict-unknown-key]
        self._head = 0
        self._in_head = True

    def on_url(self, url: bytes) -> None:
        """Take a part of the request line."""
        self._count(len(url))
        self.url += url

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a header."""
        self._count(len(name) + len(value))
        super().on_header(name, value)

    def _count(self, size: int) -> None:
        self._head += size
        if self._head > self._settings.config.max_header:
            raise ValueError("too long")  # the parser stops, and `data_received` answers

    def on_headers_complete(self) -> None:
        """Start the request."""
        self._in_head = False
        if self._slow is not None:
            self._stop_clock()
        super().on_headers_complete()

    def _give_up(self, error: RcpError, status: int) -> None:
        self._stop_clock()
        if self.transport.is_closing():
            return
        body = encode_reply(failure(error, "error"), Encoding.JSON)
        head = STATUS_LINE[status] + (
            b"content-type: application/json\r\nconnection: close\r\ncontent-length: %d\r\n\r\n"
        )
        if self.cycle is None or self.cycle.response_complete:
            self.transport.write(head % len(body) + body)
        self.transport.close()

    def _upgrade(self, rest: bytes) -> None:
        self._stop_clock()
        self.connections.discard(self)
        url = httptools.parse_url(self.url)
        raw_path = cast("bytes", url.path)
        scope = cast("dict[str, Any]", self.scope)
        scope |= {
            "type": "websocket",
            "path": unquote(raw_path.decode("ascii")),
            "raw_path": raw_path,
            "query_string": url.query or b"",
            "scheme": "wss" if self.scheme == "https" else "ws",
        }
        Upgrade(
            scope,
            self.transport,
            cast("Asgi", self.app),
            settings=self._settings,
            state=self.server_state,
            loop=self.loop,
            rest=rest,
        ).begin()
