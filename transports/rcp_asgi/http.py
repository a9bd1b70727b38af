"""HTTP framing: uvicorn's httptools protocol, with limits on headers, time and connections.

What is malformed is answered with an envelope here too, and a WebSocket handshake goes to
`Upgrade` without being written out and parsed again.
"""

from __future__ import annotations

import asyncio
from math import ceil
from typing import Any, cast
from urllib.parse import unquote

import httptools
from uvicorn.config import Config
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol
from uvicorn.server import ServerState

from rcp_asgi.endless import Endless
from rcp_asgi.seats import Seat
from rcp_asgi.settings import Settings
from rcp_asgi.upgrade import Upgrade
from rcp_kernel.access.certificates import read_certificate
from rcp_kernel.access.peer import UNKNOWN, Peer
from rcp_kernel.clients.outbound import Backlog
from rcp_kernel.door import Asgi
from rcp_kernel.errors import BadRequest, PayloadTooLarge, RcpError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_reply, failure

__all__ = ["HttpProtocol"]

_LINGER = 1.0  # s that a refused client has to read why


class HttpProtocol(HttpToolsProtocol):
    """One HTTP connection."""

    def __init__(
        self,
        *,
        settings: Settings,
        seat: Seat,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._settings = settings
        self._seat = seat
        self._head = 0
        self._in_head = True
        self._in_body = False
        self._deaf = False
        self._peer = UNKNOWN
        self._proxied = False
        self._slow: asyncio.TimerHandle | None = None
        self._extensions: dict[str, Any] = {}
        self._body: Endless | None = None
        self._backlog: Backlog | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, unless there are too many."""
        super().connection_made(transport)
        self._body = Endless(transport)
        self._backlog = self._settings.door.outbound.open(transport.abort)
        self._extensions = {"rcp.stream": self._body, "rcp.closing": self._settings.closing}
        refusal = self._seat.refusal
        if refusal is not None:
            self._turn_away(refusal)
            return
        self._extensions["rcp.peer"] = self._peer = self._seen(transport)
        address = self._peer.address
        self._proxied = address is not None and address in self._settings.proxies
        self._watch(self._settings.config.header_timeout)

    def _seen(self, transport: asyncio.Transport) -> Peer:
        address = None if self.client is None else self.client[0]
        secured = transport.get_extra_info("ssl_object")
        der = None if secured is None else secured.getpeercert(binary_form=True)
        return Peer(address, read_certificate(der) if der else None)

    def _watch(self, seconds: float) -> None:
        """Cut the connection unless `_stop_clock` comes first."""
        self._slow = self.loop.call_later(seconds, self._late)

    def _late(self) -> None:
        self._slow = None
        if self._in_body and (self.pipeline or self.flow.read_paused):
            self._watch(self._settings.config.body_timeout)  # it is us who do not read
            return
        self.transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the clock."""
        self._stop_clock()
        self._seat.leave()
        if self._body is not None:
            self._body.writable = False
        if self._backlog is not None:
            self._backlog.close()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """Hold an endless response back."""
        super().pause_writing()
        if self._body is not None:
            self._body.writable = False
        if self._backlog is not None:
            self._backlog.set(self.transport.get_write_buffer_size())

    def resume_writing(self) -> None:
        """Go on with an endless response."""
        super().resume_writing()
        if self._body is not None:
            self._body.resume()
        if self._backlog is not None and not self.flow.write_paused:
            self._backlog.set(0)

    def _stop_clock(self) -> None:
        if self._slow is not None:
            self._slow.cancel()
            self._slow = None

    def data_received(self, data: bytes) -> None:
        """Parse; what is no HTTP is told so and cut."""
        if self._deaf:
            return
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
            if self._slow is None:
                self._mind()

    def _mind(self) -> None:
        """See to it that what has begun comes to an end."""
        if self._in_head:
            self._watch(self._settings.config.header_timeout)
        elif self._in_body:
            self._watch(self._settings.config.body_timeout)
        elif self.cycle is None or self.cycle.response_complete:
            # Blank lines between requests must not stop the clock of an idle connection.
            self._unset_keepalive_if_required()
            self.timeout_keep_alive_task = self.loop.call_later(
                self.timeout_keep_alive, self.timeout_keep_alive_handler
            )

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
        self._in_body = True
        if self._slow is not None:
            self._stop_clock()
        if self._proxied:
            self._speak_for_client()
        super().on_headers_complete()

    def _speak_for_client(self) -> None:
        """Take the address that a proxy tells for that of the other end."""
        address = self._settings.proxies.client(self.headers)
        if address is not None:
            peer = Peer(address, self._peer.certificate)
            scope = cast("dict[str, Any]", self.scope)
            scope["client"] = (address, 0)
            scope["extensions"] = {**self._extensions, "rcp.peer": peer}

    def on_message_complete(self) -> None:
        """Stop the clock: the whole request is there."""
        self._in_body = False
        if self._slow is not None:
            self._stop_clock()
        super().on_message_complete()

    def _give_up(self, error: RcpError, status: int) -> None:
        self._stop_clock()
        if self.transport.is_closing():
            return
        if self.cycle is None or self.cycle.response_complete:
            self._say(error, status)
        self.transport.close()

    def _turn_away(self, error: RcpError) -> None:
        """Tell why there is no place, and let the client read it before the connection goes."""
        self._deaf = True
        self._say(error, error.http)
        self.transport.write_eof()
        self._watch(_LINGER)

    def _say(self, error: RcpError, status: int) -> None:
        body = encode_reply(failure(error, "error"), Encoding.JSON)
        head = STATUS_LINE[status] + b"content-type: application/json\r\nconnection: close\r\n"
        if error.retry_after is not None:
            head += b"retry-after: %d\r\n" % max(1, ceil(error.retry_after))
        self.transport.write(head + b"content-length: %d\r\n\r\n" % len(body) + body)

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
            seat=self._seat,
            state=self.server_state,
            loop=self.loop,
            rest=rest,
        ).begin()
