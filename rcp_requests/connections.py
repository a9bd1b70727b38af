"""The connections of sessions: whole messages in, replies and updates out."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from rcp_kernel.access.identities import Identities
from rcp_kernel.clock import iso, now
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.internal_errors import to_internal_error
from rcp_kernel.contract.metrics import RequestCounts
from rcp_kernel.contract.paths import ESTOP
from rcp_kernel.contract.peer import UNKNOWN, Peer
from rcp_kernel.errors import QueueFull, RcpError
from rcp_kernel.sessions.hello import Hello
from rcp_kernel.sessions.outbound import SHARE, SMALL, Outbound
from rcp_kernel.sessions.outbox import FlushScheduler, Outbox
from rcp_kernel.sessions.session import Answer, Handler, Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.sessions.substitutes import left_out
from rcp_kernel.values import Encoding, value_type
from rcp_kernel.wire import (
    NO_BODY,
    Reply,
    Request,
    check_size,
    decode_request,
    encode_reply,
    failure,
    peek_header,
)
from rcp_protocol.structure import LONG, check_structure
from rcp_requests.handshake import Handshake
from rcp_scheduling.turns import Turns, Work

__all__ = ["Connection", "ConnectionParts"]

_BUFFERED = 256  # messages that wait for a `hello`


_HELLO = value_type(Hello)
AtOnce = Mapping[str, Callable[[Session, Request], bytes | None]]


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectionParts:
    """The parts of the gateway that connections use, shared by all of them."""

    handle: Handler
    prepare: Callable[[Session, Request], Generator[None, None, Request]]
    """Decodes a long body in steps."""
    at_once: AtOnce
    """By type of request, a handler for its usual form, which returns the reply in JSON."""
    handshake: Handshake
    sessions: Sessions
    identities: Identities
    refuse_hello: Callable[[Session, Reply, Answer], Answer]
    """Records that a `hello` was refused; returns the function to send its reply with."""
    counts: RequestCounts
    outbound: Outbound
    settings: Settings
    scheduler: FlushScheduler
    turns: Turns
    loop: asyncio.AbstractEventLoop


class Connection:
    """The gateway's end of one client connection.

    The transport feeds `receive` with whole messages, is called by `flush` when there is
    something to send, and takes it with `outbox.collect`. All on the event loop's thread.
    """

    __slots__ = (
        "_at_once",
        "_buffer",
        "_handle",
        "_identifying",
        "_parts",
        "_settings",
        "closed",
        "encoding",
        "expelled",
        "hellos",
        "on_hello",
        "on_other",
        "one_way",
        "outbox",
        "peer",
        "released",
        "session",
    )

    def __init__(
        self,
        parts: ConnectionParts,
        session: Session,
        encoding: Encoding,
        flush: Callable[[], None],
        peer: Peer = UNKNOWN,
        *,
        one_way: bool = False,
    ) -> None:
        self._parts = parts
        self._handle = parts.handle
        self._at_once: AtOnce = parts.at_once if encoding is Encoding.JSON else {}
        self._settings = parts.settings
        self.peer = peer
        self.encoding = encoding
        self.outbox = Outbox(parts.scheduler, encoding, flush, parts.outbound.open())
        self.session = session
        self.closed = False
        self.one_way = one_way
        """Whether the client sends no requests (SSE): it receives, and commands nothing."""
        self.expelled = False
        """The session was ended by the gateway; the transport closes once it has said so."""
        self.hellos = 0
        self.on_hello: Callable[[Hello], dict[str, Any]] | None = None
        """The transport's part of `hello`: the options it adopts, and the limits it returns."""
        self.on_other: Callable[[bytes], bool] | None = None
        """Takes messages of the transport's own, and returns whether it has: it gets those that are
        long, or no request."""
        self.released: Callable[[deque[bytes]], None] = self._receive_all
        """Handles messages received while `hello` waited; a transport with its own turns
        replaces it."""
        self._buffer: deque[bytes] | None = None
        """Unhandled messages since a `hello` or a long message."""
        self._identifying: asyncio.Task[None] | None = None
        session.connection = self
        session.one_way = one_way
        session.encoding = encoding

    def set_callbacks(
        self,
        *,
        hello: Callable[[Hello], dict[str, Any]],
        released: Callable[[deque[bytes]], None],
        cut: Callable[[], None],
    ) -> None:
        """Set the callbacks of a transport.

        `hello` adopts what a client requests, and returns facts for the reply. `released` gets the
        messages received while an earlier one was being handled, to pass them to `receive` in its
        turns. `cut` closes a client that does not read.
        """
        self.on_hello, self.released = hello, released
        self.outbox.backlog.close_client = cut

    @property
    def limit(self) -> int:
        """Longest message that the client may send now, in bytes."""
        return self._parts.identities.longest(self.session.principal)

    @property
    def buffering(self) -> bool:
        """Whether a `hello` or a long message is not handled yet, and later messages wait."""
        return self._buffer is not None

    def receive(self, data: bytes) -> None:
        """Handle one whole message from the client; every reply goes through the outbox.

        A message after `close` is ignored: the session may belong to another connection by now.
        """
        if self.closed:
            return
        if self._buffer is not None:
            self._put_off(data)
            return
        try:
            if len(data) > LONG:
                if self.on_other is None or not self.on_other(data):
                    self._take_long(data)
                return
            request = decode_request(data, self.encoding)
            outbox = self.outbox
            at_once = self._at_once.get(request.type)
            if at_once is not None and outbox.waiting <= SHARE:
                reply = at_once(self.session, request)
                if reply is not None:
                    size = len(reply)
                    if size > SMALL or not outbox.dirty:
                        outbox.put(reply if size <= SMALL else self._bounded(request, reply))
                    else:  # `put` without a call, as nearly all replies pass here
                        outbox.control.append(reply)
                        outbox.waiting += size
                        if outbox.waiting > SHARE:
                            outbox.update_backlog()
                    return
            if request.type == "hello":
                self._hello(request)
            else:
                self._handle(self.session, request, self.session.deliver)
        except RcpError as error:
            if self.on_other is None or not self.on_other(data):
                self._refuse(data, error)
        except Exception as error:
            self.answer_internal_error(data, error)

    def _take_long(self, data: bytes) -> None:
        """Handle a message when its turn has come, and before all later ones."""
        check_size(data, self.limit)
        if len(data) > self._settings.limits.unproved:
            self.session.check_pace()
        buffer = self._buffer = deque()
        work = self._unfold(data, buffer)
        try:
            self._parts.turns.run(self.session.principal.identity, work, len(data))
        except RcpError:
            self._buffer = None
            raise

    def _unfold(self, data: bytes, buffer: deque[bytes]) -> Work:
        """Handle a long message in steps: count its values, decode the envelope, then the rest."""
        try:
            yield from check_structure(data, self.encoding, self._settings.limits.values)
            request = decode_request(data, self.encoding)
            yield
            if not self.closed:
                request = yield from self._parts.prepare(self.session, request)
            if not self.closed:
                self._buffer = None  # a `hello` may start to buffer messages itself
                if request.type == "hello":
                    self._hello(request)
                else:
                    self._handle(self.session, request, self.session.deliver)
        except RcpError as error:
            self._refuse(data, error)
        except Exception as error:
            self.answer_internal_error(data, error)
        if self._buffer is buffer:
            self._buffer = None
        if self._buffer is None:
            self.released(buffer)
        else:
            self._buffer.extend(buffer)

    def _refuse(self, data: bytes, error: RcpError) -> None:
        type_, id_ = peek_header(data, self.encoding)
        self._parts.counts.count(self.session.transport, type_, error.code)
        self.send(failure(error, type_, id_))

    def answer_internal_error(self, data: bytes, error: Exception) -> None:
        """Answer a message whose handling failed unexpectedly, and log why."""
        internal = to_internal_error(error, session=self.session.id)
        type_, id_ = peek_header(data, self.encoding)
        self._parts.counts.count(self.session.transport, type_, internal.code)
        self.send(failure(internal, type_, id_))

    def send(self, reply: Reply) -> None:
        """Queue a reply; unread feedback of a slow client is replaced by newer feedback."""
        if self.closed:
            return
        outbox = self.outbox
        if reply.command is not None:
            if reply.status == "in_progress":
                outbox.feedback[reply.command] = partial(self._encode_feedback, reply)
                if not outbox.dirty:
                    outbox.mark()
                return
            outbox.begins = reply.status == "accepted"
            last = outbox.feedback.pop(reply.command, None)
            if last is not None:
                outbox.put(last())
        try:
            data = encode_reply(reply, self.encoding)
        except Exception as error:
            data = self._encode_failure(reply, error)
        if len(data) > SMALL and reply.path != ESTOP and outbox.backlog.refuses(len(data)):
            data = self.encode(left_out(reply, len(data)))
        outbox.put(data)

    def _bounded(self, request: Request, reply: bytes) -> bytes:
        """Return a reply that is already counted, or a substitute if it does not fit."""
        if not self.outbox.backlog.refuses(len(reply)):
            return reply
        answer = Reply(type=request.type, id=request.id, path=request.path)
        return self.encode(left_out(answer, len(reply)))

    def encode(self, reply: Reply) -> bytes:
        """Encode a reply; if that fails, its error instead."""
        try:
            return encode_reply(reply, self.encoding)
        except Exception as error:
            return self._encode_failure(reply, error)

    def _encode_failure(self, reply: Reply, error: Exception) -> bytes:
        internal = to_internal_error(error, path=reply.path)
        substitute = failure(internal, reply.type, reply.id, reply.path, command=reply.command)
        return encode_reply(substitute, self.encoding)

    def _encode_feedback(self, reply: Reply) -> bytes:
        """Write feedback, which never ends its command: without the body if that cannot be written."""
        try:
            return encode_reply(reply, self.encoding)
        except Exception as error:
            to_internal_error(error, path=reply.path)
            reply.body, reply.custom = NO_BODY, None
            return encode_reply(reply, self.encoding)

    def _hello(self, request: Request) -> None:
        try:
            self.hellos += 1
            if self.hellos > 1:  # the first one is free: who wants to stop a robot must get in
                self.session.charge()
            hello = request.decode_body(_HELLO, "hello") if request.body else Hello()
            token = self._parts.handshake.offered(hello)
            principal = None
            if token is not None:
                principal = self._parts.identities.known(token, self.peer)
                if principal is None:
                    self._buffer = deque()
                    self._identifying = self._parts.loop.create_task(
                        self._identify(request, hello, token)
                    )
                    return
            self._greet(request, hello, principal)
        except Exception as error:
            self._refuse_hello(request, error)

    def _greet(self, request: Request, hello: Hello, principal: Principal | None) -> None:
        body = self._parts.handshake.greet(self, hello, principal)
        self._parts.counts.count(self.session.transport, "hello", "ok")
        reply = Reply(type="hello", id=request.id, body=body, timestamp=iso(now()))
        # Before the messages of a resumed session: the client must first know which session it has.
        self.outbox.put_first(encode_reply(reply, self.encoding))

    def _refuse_hello(self, request: Request, error: Exception) -> None:
        internal = to_internal_error(error)
        self._parts.counts.count(self.session.transport, "hello", internal.code)
        reply = failure(internal, "hello", request.id)
        self._parts.refuse_hello(self.session, reply, self.send)(reply)

    async def _identify(self, request: Request, hello: Hello, token: str) -> None:
        """Identify the principal of a token, while the client's next messages wait."""
        try:
            principal = await self._parts.identities.wait(token, self.peer)
            if not self.closed:
                self._greet(request, hello, principal)
        except Exception as error:
            self._refuse_hello(request, error)
        buffer, self._buffer = self._buffer or deque(), None
        self.released(buffer)

    def _receive_all(self, messages: deque[bytes]) -> None:
        for data in messages:
            self.receive(data)

    def _put_off(self, data: bytes) -> None:
        buffer = self._buffer
        assert buffer is not None
        if len(buffer) < _BUFFERED and sum(map(len, buffer)) + len(data) <= self.limit:
            buffer.append(data)
            return
        type_, id_ = peek_header(data, self.encoding)
        self._parts.counts.count(self.session.transport, type_, QueueFull.code)
        self.send(failure(QueueFull("an earlier message is not handled yet"), type_, id_))

    def close(self, *, resumable: bool = True) -> None:
        """Report that the client has disconnected, and whether it may resume its session."""
        if not self.closed:
            self.closed = True
            self.session.resumable &= resumable
            if self._identifying is not None:
                self._identifying.cancel()
            self._parts.sessions.tally(self)
            self.outbox.close()
            self._parts.sessions.disconnect(self.session)
