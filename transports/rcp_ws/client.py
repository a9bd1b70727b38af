"""One client: connects its WebSocket to its connection to the gateway."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from time import perf_counter
from typing import Any

import structlog

from rcp_kernel.api import BACKLOG_SHARE, Hello, Peer, Principal
from rcp_kernel.client_api import ClientApi
from rcp_kernel.errors import BadRequest, PayloadTooLarge, RcpError, Unauthenticated
from rcp_kernel.values import Encoding
from rcp_kernel.wire import failure, peek_header
from rcp_web.read_gate import ReadGate
from rcp_web.socket import NativeSocket
from rcp_ws import segments
from rcp_ws.config import WsConfig
from rcp_ws.incoming import Incoming
from rcp_ws.outgoing import Outgoing
from rcp_ws.segments import Again

__all__ = ["WsClient"]

log = structlog.get_logger("rcp.ws")
_NOBODY = Principal("nobody", ())
_PATIENCE = 10.0  # s for a client to authenticate in `hello`
_POLICY = 1008
_INTERNAL = 1011
_TRY_LATER = 1013
_UNTAKEN = "too many unread bytes"
_LAST = 32  # times the data sent per turn, before a connection is closed: 8 MiB
_SEGMENT = b"segment"  # only a message with this word can be a segment
_TURN = 0.0005  # s of processing per client and turn; then others have theirs
_LEAST = 0.0002  # s guaranteed per client even if the total is used up: an e-stop takes less
_COUNTED = 0.00002  # s of processing per read below which it is not counted
_SHORT = 4096  # bytes of a message that is always accepted
_LOOK_EVERY = 32  # replies between checks whether the client reads them


class WsClient:
    """Passes messages to the connection, and the contents of the outbox to the socket."""

    __slots__ = (
        "_began",
        "_config",
        "_encoding",
        "_gate",
        "_incoming",
        "_limit",
        "_look_at",
        "_outbox",
        "_outgoing",
        "_patience",
        "_plain",
        "_receive",
        "_socket",
        "_turn",
        "_turns",
        "_used",
        "connection",
        "gone",
    )

    def __init__(
        self,
        client_api: ClientApi,
        config: WsConfig,
        who: tuple[Principal | None, str | None],
        encoding: Encoding,
        socket: NativeSocket,
        end: Peer,
    ) -> None:
        self._config = config
        self._socket = socket
        self._encoding = encoding
        self._turns = client_api.turns
        self._limit = 0
        principal, tenant = who
        self.connection = client_api.connect(
            principal or _NOBODY, encoding, self.flush, tenant, end
        )
        self._outbox = self.connection.outbox
        self._receive: Callable[[bytes], None] = self.connection.receive
        self._patience: asyncio.TimerHandle | None = None
        if principal is None:
            self._receive = self._greeting
            self._patience = client_api.loop.call_later(_PATIENCE, self._turn_away)
        self._look_at = min(_LOOK_EVERY, config.backlog)
        self._gate = ReadGate(
            socket,
            wait=self._wait,
            handle=self.received,
            settle=self.settled,
            full=self._full,
            failed=self._broken,
        )
        self.connection.set_callbacks(
            hello=self._hello, released=self._gate.put_back, cut=self._cut_off
        )
        self._began = 0.0
        """Start of processing the current read, to all of which `settled` sends the replies; 0 between reads."""
        self._turn, self._used = 0, 0.0
        """Number of the current turn, and the time used in it."""
        self._incoming = Incoming(config, whole=self._whole, again=self._again, failed=self._fail)
        room = client_api.limits.queue_bytes // 4
        park = self._outbox.park
        self._outgoing = Outgoing(encoding, config.kept, room, client_api.loop, park)
        self._plain = False
        """Whether replies need neither compression nor segmentation."""
        self.gone = asyncio.Event()
        self._adopt_limit()

    def opened(self) -> None:
        """Apply the result of the handshake."""
        self._agree()

    def _agree(self) -> None:
        socket, outbox = self._socket, self._outbox
        self._plain = self._outgoing.size is None and not socket.compresses
        if self._plain:
            outbox.send_frames(socket.head, socket.pass_on)
        else:
            outbox.send_messages(long=self._outgoing.size is not None)

    # -- receiving -----------------------------------------------------------------------------

    def received(self, data: bytes, text: bool = True) -> None:  # noqa: FBT001, FBT002 - see Receiver
        """Handle a message of the client, or keep it until the client's next turn."""
        gate, size = self._gate, len(data)
        if not gate.handing and (
            gate.paused
            or (self._began and perf_counter() - self._began > _LEAST and self._over())
            or (size > _SHORT and self._turns.over)
        ):
            gate.keep(data)
            if not gate.paused:
                gate.end_turn()
            return
        if size > self._limit:
            self.oversized(size)
            return
        outbox = self._outbox
        if not self._began:
            self._began = perf_counter()
            outbox.dirty = True  # no tick: `settled` sends the replies
        try:
            # Segments are reassembled for authenticated clients only. `in` would take twice as
            # long as `find`: it first tries to take the word for the number of a byte.
            may_be_segment = data.find(_SEGMENT) >= 0 and self._patience is None
            if not (may_be_segment and self._segment(data)):
                self._receive(data)
        except Exception as error:
            # Otherwise the client would wait for its reply forever.
            self.connection.stumbled(data, error)
        if len(outbox.control) >= self._look_at or outbox.waiting > BACKLOG_SHARE:
            self.flush()
            gate.review()
        if size > _SHORT and self.connection.buffering:
            gate.review()
        if gate.handing and self._over():
            gate.end_turn()

    def _over(self) -> bool:
        """Return whether the messages of the current read have used up the client's turn."""
        spent = perf_counter() - self._began
        return spent > _LEAST and (spent > _TURN or self._turns.over)

    def other_frame(self) -> None:
        """Count the time of a frame that is not a whole message."""
        if not self._began:
            self._began = perf_counter()
            self._outbox.dirty = True
        elif perf_counter() - self._began > _TURN:
            self._gate.end_turn()

    def _wait(self, go_on: Callable[[], None]) -> None:
        self._turns.call(self.connection.session.principal.identity, go_on)

    def _count(self, seconds: float) -> None:
        """Count the processing time of a read: the loop reads several times per turn."""
        turns = self._turns
        turns.add(seconds)
        if self._turn != turns.number:
            self._turn, self._used = turns.number, 0.0
        self._used += seconds
        if self._used > _LEAST and (self._used > _TURN or turns.over):
            self._gate.end_turn()

    def _full(self) -> bool:
        """Return whether reading from the client must pause until `review` is called.

        Either it does not read what it requested, and a flush follows, or one of its messages is
        still being handled, and `released` follows.
        """
        if self.connection.buffering:
            return True
        outbox = self._outbox
        sends = outbox.control or self._outgoing.busy or not self._socket.writable
        return bool(sends) and (len(outbox.control) >= self._config.backlog or outbox.crowded)

    def settled(self) -> None:
        """Send the replies to the messages of one read.

        What begins a command is left to the tick of this turn of the loop: a robot that answers at once
        has its result in the same write.
        """
        outbox, socket = self._outbox, self._socket
        began, self._began = self._began, 0.0
        outbox.dirty = False
        if outbox.begins:
            outbox.begins = False
            outbox.mark()
        elif (
            len(outbox.control) == 1
            and self._plain
            and socket.writable
            and not (outbox.pending or outbox.feedback)
        ):
            outbox.waiting = 0
            socket.reply(outbox.control.pop())
        elif not self._plain or outbox.control or outbox.feedback or outbox.pending:
            self.flush()
        # Kept messages are counted in the turn that they waited for.
        if began and not self._gate.handing and (spent := perf_counter() - began) > _COUNTED:
            self._count(spent)

    def _greeting(self, data: bytes) -> None:
        """Accept only `hello` from a client that is not authenticated."""
        type_, id_ = peek_header(data, self._encoding)
        if type_ != "hello" and not self.connection.buffering:
            error = Unauthenticated("authentication required")
            self.connection.send(failure(error, type_, id_))
            return
        self.connection.receive(data)

    def _cut_off(self) -> None:
        """Close a client that does not read, to free its memory.

        It may never see the reason, because the close frame follows the data that it does not read.
        """
        session = self.connection.session
        log.warning(
            "websocket_cut",
            session=session.id[:8],
            principal=session.principal.name,
            code=_TRY_LATER,
            reason=_UNTAKEN,
        )
        self._close(_TRY_LATER, _UNTAKEN)

    def _turn_away(self) -> None:
        self._close(_POLICY, "not authenticated")

    def _end_patience(self) -> None:
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None

    def _broken(self, error: Exception) -> None:
        """Close a connection after an internal error: its data may have gaps."""
        log.error("websocket_failed", session=self.connection.session.id, exc_info=error)
        self._close(_INTERNAL, "the gateway failed; see its log")

    def _close(self, code: int, reason: str) -> None:
        self._gate.close()
        self._socket.close(code, reason)

    def garbled(self, data: bytes) -> None:
        """Reply to a text message that is not UTF-8, before the socket closes."""
        type_, id_ = peek_header(data, self._encoding)
        error = BadRequest("the text message is not UTF-8")
        self._socket.write([self.connection.encode(failure(error, type_, id_))])

    def oversized(self, size: int) -> None:
        """Reply to a message that was discarded because of its size."""
        error = PayloadTooLarge(
            f"the message is longer than {self._limit} bytes", details={"limit": self._limit}
        )
        self.connection.send(failure(error, "error"))

    def lost(self, code: int) -> None:
        """Release the connection; its session waits for the client to return."""
        self._end_patience()
        self._gate.close()
        self._incoming.close()
        self._outgoing.close()
        self.connection.close()
        self.gone.set()

    # -- segments ------------------------------------------------------------------------------

    def _segment(self, data: bytes) -> bool:
        """Handle a message that may be a segment; return whether it was one."""
        id_: str | int | None = None
        try:
            found = segments.read(data, self._encoding)
            if found is None:
                return False
            id_ = found.id
            if isinstance(found, Again):
                self._outgoing.again(found)
                self._outbox.mark()
            else:
                self._incoming.take(found)
        except RcpError as error:
            self._fail(id_, error)
        return True

    def _whole(self, data: bytes) -> None:
        self._receive(data)

    def _fail(self, id_: str | int | None, error: RcpError) -> None:
        self.connection.send(failure(error, "segment", None if id_ is None else str(id_)))

    def _again(self, id_: str | int, missing: list[int]) -> None:
        self._outbox.put(segments.request_again(id_, missing, self._encoding))

    def _hello(self, hello: Hello) -> dict[str, Any]:
        if self.connection.session.principal is not _NOBODY:
            self._receive = self.connection.receive
            self._end_patience()
        self._adopt_limit()
        wanted = hello.segment_size
        agreed = None if wanted is None else min(wanted, self._config.segment_size)
        self._outgoing.size = agreed
        self._agree()
        return {"limits": {"segment_size": agreed, "segments": self._config.segments}}

    def _adopt_limit(self) -> None:
        """Set the maximum message size to that of the authenticated caller."""
        self._limit = self._socket.limit = self._incoming.limit = self.connection.limit

    # -- sending -------------------------------------------------------------------------------

    def flush(self) -> None:
        """Send pending data, if the socket accepts it."""
        socket, outbox = self._socket, self._outbox
        try:
            if self.connection.expelled:
                self._flush_last()
                return
            if socket.writable:
                if not self._plain:
                    self._send_messages()
                elif parts := outbox.collect():
                    socket.write_frames(parts)
            if not socket.writable:
                outbox.hand(socket.buffered)
            else:
                if outbox.buffered:
                    outbox.hand(0)
                if outbox.control or outbox.feedback or outbox.pending:
                    outbox.again()
            if self._gate.paused:
                self._gate.review()
        except Exception as error:
            self._broken(error)

    def _send_messages(self) -> None:
        """Send as much as one turn allows, compressed or in segments."""
        if self._outgoing.size is not None:
            self._flush_cut(self._outgoing, self._outgoing.size)
        elif messages := self._outbox.collect():
            self._socket.write(messages)

    def _flush_last(self) -> None:
        """Send the remaining data before the end, which may include its reason."""
        self._gate.close()
        outbox = self._outbox
        for _ in range(_LAST):
            if not self._plain:
                self._send_messages()
            elif parts := outbox.collect():
                self._socket.write_frames(parts)
            if not (outbox.control or outbox.feedback or self._outgoing.busy):
                break
        self._close(_POLICY, "the session has ended or moved to another connection")

    def _flush_cut(self, outgoing: Outgoing, size: int) -> None:
        busy = outgoing.busy
        messages = self._outbox.collect(big=size if busy else None)
        messages = outgoing.sift(messages)
        if outgoing.busy:
            messages.append(outgoing.next())
        if messages:
            self._socket.write(messages)
        if outgoing.busy:
            self._outbox.mark()

    def drained(self) -> None:
        """Continue: the client is reading again."""
        self.flush()
