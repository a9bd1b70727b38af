"""HTTP framing: uvicorn's httptools protocol, with limits on headers, time and connections.

Malformed requests are also answered with an envelope, in order, and a WebSocket handshake is passed
to `Upgrade` without being serialised and parsed again. The bytes of one read are parsed in slices,
one per loop iteration: 256 KiB hold thousands of requests.
"""

from __future__ import annotations

import asyncio
import re
from math import ceil
from typing import Any, cast
from urllib.parse import unquote

import httptools
from uvicorn.config import Config
from uvicorn.protocols.http.flow_control import HIGH_WATER_LIMIT
from uvicorn.protocols.http.httptools_impl import (
    STATUS_LINE,
    HttpToolsProtocol,
    RequestResponseCycle,
)
from uvicorn.server import ServerState

from rcp_asgi.certificates import read_certificate
from rcp_asgi.connection_limiter import Seat
from rcp_asgi.endless import Endless
from rcp_asgi.exchange import Exchange
from rcp_asgi.flow import ReadFlow
from rcp_asgi.request_head import (
    HeadTooLong,
    Malformed,
    TargetTooLong,
    UnknownMethod,
    check_head,
)
from rcp_asgi.settings import Settings
from rcp_asgi.upgrade import Upgrade
from rcp_gateway.api import UNKNOWN_PEER, Backlog, Peer
from rcp_gateway.client_api import Asgi
from rcp_kernel.errors import RcpError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_reply, failure

__all__ = ["HttpProtocol"]

_LINGER = 1.0  # s for a refused client to read the reason
_SLICE = 4 * 1024  # bytes parsed per loop iteration: at most some hundred requests
_BODY_SLICE = 64 * 1024  # bytes of a body of known length, which are cheap to parse
_METHOD = re.compile(rb"[!#$%&'*+.^_`|~0-9A-Za-z-]{1,64} ")


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
        self._owed = 0
        """Remaining bytes of the body, by its Content-Length."""
        self._silent = 0
        """Bytes since the parser's last callback: it buffers an unfinished header."""
        self._too_late = 0
        """Bytes of the body since its response was complete."""
        self._unread: bytes | memoryview = b""
        self._turn: asyncio.Handle | None = None
        self._deaf = False
        self._fault: RcpError | None = None
        """The error found by a parser callback."""
        self._ended = False
        """The client has closed its sending side, and may still read."""
        self._farewell: asyncio.TimerHandle | None = None
        self._parting: RcpError | None = None
        """The error to send after the pending responses."""
        self._peer = UNKNOWN_PEER
        self._proxied = False
        self._slow: asyncio.TimerHandle | None = None
        self._extensions: dict[str, Any] = {}
        self._body: Endless | None = None
        self._backlog: Backlog | None = None
        self._answered: RequestResponseCycle | None = None
        """The request being answered; `cycle` is the last one received."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept a connection, unless a limit is exceeded."""
        super().connection_made(transport)
        self.flow = self._reading = ReadFlow(transport)
        self._body = Endless(transport)
        self._backlog = self._settings.client_api.outbound.open(transport.abort)
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
        """Close the connection unless `_stop_clock` is called first."""
        self._slow = self.loop.call_later(seconds, self._late)

    def _late(self) -> None:
        self._slow = None
        if self._in_body and not self._deaf and (self.pipeline or self.flow.read_paused):
            self._watch(self._settings.config.body_timeout)  # the gateway itself has paused reading
            return
        if not self.transport.is_closing():
            self.transport.close()

    def shutdown(self) -> None:
        """Close when the response is complete."""
        if not self.transport.is_closing():  # asyncio can abort no TLS that was closed twice
            super().shutdown()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timer."""
        self._stop_clock()
        self._deaf = True
        self._unread = b""
        for handle in (self._turn, self._farewell):
            if handle is not None:
                handle.cancel()
        self._seat.leave()
        if self._body is not None:
            self._body.writable = False
        if self._backlog is not None:
            self._backlog.close()
        super().connection_lost(exc)
        answered = self._answered
        if answered is not None and not answered.response_complete:
            answered.disconnected = True
            answered.message_event.set()

    def pause_writing(self) -> None:
        """Pause an endless response."""
        super().pause_writing()
        if self._body is not None:
            self._body.writable = False
        if self._backlog is not None:
            self._backlog.set(self.transport.get_write_buffer_size())

    def resume_writing(self) -> None:
        """Resume an endless response."""
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
        """Parse; malformed input is answered with an error, then the connection closes."""
        if self._deaf:
            return
        if self._unread:  # pauses reading in the next loop iteration
            self._unread = bytes(self._unread) + data
            return
        self._unread = data if len(data) <= _SLICE else memoryview(data)
        self._parse()

    def _parse(self) -> None:
        """Parse one slice of the input."""
        self._turn = None
        self._unset_keepalive_if_required()
        size = max(_SLICE, min(self._owed, _BODY_SLICE))
        part, self._unread = self._unread[:size], self._unread[size:]
        self._silent += len(part)
        late = self._in_body and self.cycle is not None and self.cycle.response_complete
        self._too_late = self._too_late + len(part) if late else 0
        try:
            self.parser.feed_data(part)
        except httptools.HttpParserUpgrade as upgrade:
            rest = bytes(part[upgrade.args[0] :]) + bytes(self._unread)
            if not self._should_upgrade():
                self._unread = memoryview(rest)
                self._go_on_without_upgrade()
            elif self.cycle is None or self.cycle.response_complete:
                self._upgrade(rest)
                return
            else:
                self._give_up(
                    Malformed("a WebSocket cannot start before the previous request is answered")
                )
                return
        except httptools.HttpParserError as error:
            self._give_up(self._fault or _fault_of(error, part))
            return
        if self._silent > self._settings.config.max_header and self._owed <= 0:
            self._give_up(HeadTooLong("the request's headers are too long"))
            return
        if self._too_late > self._settings.client_api.limits.message:  # longer than any may be
            self._leave()
            return
        self._continue()

    def _continue(self) -> None:
        """Continue with the unparsed input, once the pending requests allow it."""
        if self._unread:
            self._reading.hold()
            if self._turn is None and not self.pipeline:
                self._turn = self.loop.call_soon(self._parse)
            return
        self._reading.release()
        full = self.cycle is not None and len(self.cycle.body) > HIGH_WATER_LIMIT
        if not self.pipeline and not full:
            self.flow.resume_reading()
        if self._ended:
            self._conclude()
        elif self._slow is None:
            self._mind()

    def eof_received(self) -> bool:  # type: ignore[override] - asyncio takes either
        """Answer a client that has closed its sending side, if that takes only a moment."""
        begun = self.cycle is not None and self.cycle.response_started
        if begun and not self.cycle.response_complete:
            return False  # an endless response, whose client has gone
        if not self.transport.can_write_eof() or self.transport.is_closing():
            return False
        if self._deaf and self._parting is None:
            return False  # it is already answered
        self._ended = True
        self._farewell = self.loop.call_later(_LINGER, self.transport.close)
        if not self._deaf:
            self._conclude()
        return True

    def _conclude(self) -> None:
        """Close once everything received before the end is answered."""
        if self._unread:
            return
        if self._in_body or (self._in_head and (self._head or self._silent)):
            self._give_up(Malformed("the connection closed before the request was complete"))
        elif self.cycle is None or self.cycle.response_complete:
            self.transport.close()

    def _go_on_without_upgrade(self) -> None:
        """Process a request as if it had not asked for an upgrade (RFC 9110, 7.8).

        After an upgrade the parser does not parse what follows, so a new parser takes over.
        """
        scope = self.scope
        lines = [f"{scope['method']} ".encode(), self.url, b" HTTP/1.1\r\n"]
        for name, value in self.headers:
            if name == b"connection":
                kept = [part for part in value.split(b",") if part.strip().lower() != b"upgrade"]
                lines.append(b"connection: %b\r\n" % b",".join(kept))
            elif name != b"upgrade":
                lines.append(b"%b: %b\r\n" % (name, value))
        self.parser = httptools.HttpRequestParser(self)
        self.parser.set_dangerous_leniencies(lenient_data_after_close=True)
        self.parser.feed_data(b"".join([*lines, b"\r\n"]))

    def _mind(self) -> None:
        """Start the timer for the present state."""
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
        """Start to count the size of the headers."""
        super().on_message_begin()
        self.scope["extensions"] = self._extensions  # type: ignore[typeddict-unknown-key]
        self._head = 0
        self._in_head = True

    def on_url(self, url: bytes) -> None:
        """Handle a part of the request line."""
        self._silent = 0
        self._head += len(url)
        if self._head > self._settings.config.max_header:
            self._fault = TargetTooLong("the request line is too long")
            raise self._fault  # the parser stops and `_parse` replies
        self.url += url

    def on_header(self, name: bytes, value: bytes) -> None:
        """Handle a header; trailers are counted and dropped, because nothing uses them."""
        self._silent = 0
        self._head += len(name) + len(value) + 4
        if self._head > self._settings.config.max_header:
            self._fault = HeadTooLong("the request's headers are too long")
            raise self._fault
        if self._in_head:  # as uvicorn does, which is called for each of them
            name = name.lower()
            if name == b"expect" and value.lower() == b"100-continue":
                self.expect_100_continue = True
            self.headers.append((name, value))

    def on_headers_complete(self) -> None:
        """Start the request."""
        self._in_head = False
        self._silent = 0
        if self._slow is not None:
            self._stop_clock()
        parser, headers = self.parser, self.headers
        method, version = parser.get_method(), parser.get_http_version()
        try:
            self.url, length = check_head(method, version, self.url, headers)
        except RcpError as fault:
            self._fault = fault
            raise
        self.scope["method"] = method.decode("ascii")
        self.scope["http_version"] = version
        upgrades = parser.should_upgrade()
        if upgrades and not self._should_upgrade():
            return
        self._in_body = True
        self._owed = length
        if self._proxied:
            self._speak_for_client()
        if not upgrades:
            self._begin(version)

    def _begin(self, version: str) -> None:
        """Start the handler of a request, after those before it."""
        scope: Any = self.scope
        app: Any = self.app
        url: Any = httptools.parse_url(self.url)
        path: bytes = url.path
        text = path.decode("ascii")
        scope["path"] = unquote(text) if "%" in text else text
        scope["raw_path"] = path
        scope["query_string"] = url.query or b""
        before, self.cycle = (
            self.cycle,
            Exchange(
                scope=scope,
                transport=self.transport,
                flow=self.flow,
                logger=self.logger,
                access_logger=self.access_logger,
                access_log=self.access_log,
                default_headers=self.server_state.default_headers,
                message_event=asyncio.Event(),
                expect_100_continue=self.expect_100_continue,
                keep_alive=version != "1.0" and self.parser.should_keep_alive(),
                on_response=self.on_response_complete,
            ),
        )
        if before is None or before.response_complete:
            self._start_asgi_task(self.cycle, app)
        else:
            self.flow.pause_reading()
            self.pipeline.appendleft((self.cycle, app))
        if not self.pipeline:
            self._answered = self.cycle

    def _speak_for_client(self) -> None:
        """Replace the peer's address by the one that a trusted proxy reports."""
        address = self._settings.proxies.client(self.headers)
        if address is not None:
            peer = Peer(address, self._peer.certificate)
            scope = cast("dict[str, Any]", self.scope)
            scope["client"] = (address, 0)
            scope["extensions"] = {**self._extensions, "rcp.peer": peer}

    def on_body(self, body: bytes) -> None:
        """Handle a part of the body."""
        self._silent = 0
        self._owed -= len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        """Stop the timer: the request is complete."""
        if not self._in_body:
            return  # already restarted, see `_go_on_without_upgrade`
        self._in_body = False
        self._owed = self._silent = 0
        if self._slow is not None:
            self._stop_clock()
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Continue with the input that follows the request."""
        last = not self.pipeline
        if not last:
            self._answered = self.pipeline[-1][0]
        super().on_response_complete()
        if last and self._parting is not None:
            self._part(self._parting)
        elif self._unread and self._turn is None and not self.pipeline and not self._deaf:
            self._turn = self.loop.call_soon(self._parse)
        elif last and self._ended:
            self._conclude()

    def _give_up(self, error: RcpError) -> None:
        """Stop reading, and send the error after the pending responses."""
        self._stop_clock()
        self._deaf = True
        self._unread = b""
        if self.transport.is_closing():
            return
        self._settings.client_api.refused("request", error.code)
        cycle = self.cycle
        if self._in_body and self.pipeline:
            self.pipeline.popleft()  # the latest, which is the malformed one
        elif self._in_body:
            begun = cycle.response_started
            cycle.disconnected = True
            cycle.message_event.set()
            if begun:
                self.transport.close()
            else:
                self._part(error)
            return
        elif cycle is None or cycle.response_complete:
            self._part(error)
            return
        self._parting = error
        self._watch(self._settings.config.body_timeout)

    def _part(self, error: RcpError) -> None:
        """Send the error and close."""
        if not self.transport.is_closing():
            self._say(error, error.http)
        self._leave()

    def _leave(self) -> None:
        """Read no more, and close; lingers, because closing at once would reset the connection."""
        self._unset_keepalive_if_required()
        self._stop_clock()
        self._deaf = True
        self._unread = b""
        if self.transport.is_closing():
            return
        self._reading.release()
        self.flow.resume_reading()
        if self.transport.can_write_eof() and not self._ended:
            self.transport.write_eof()
            self._watch(_LINGER)
        else:
            self.transport.close()

    def _turn_away(self, error: RcpError) -> None:
        """Refuse the connection, and let the client read the reason before closing."""
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


def _fault_of(error: Exception, data: bytes | memoryview) -> RcpError:
    """Return the error for a parser failure."""
    if isinstance(error, httptools.HttpParserInvalidMethodError) and _METHOD.match(data):
        return UnknownMethod("the method is not supported")
    reason = "" if isinstance(error, httptools.HttpParserCallbackError) else f": {error}"
    return Malformed(f"malformed HTTP/1.1 request{reason}")
