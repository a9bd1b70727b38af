"""A client of a WebSocket: reads it in its turns of the loop, and sends what its outbox has."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable
from time import perf_counter
from typing import ClassVar

import structlog

from rcp_gateway.api import BACKLOG_SHARE, Peer, Principal
from rcp_gateway.client_api import ClientApi
from rcp_kernel.values import Encoding
from rcp_web.read_gate import ReadGate
from rcp_web.socket import NativeSocket

__all__ = ["SocketClient"]

log = structlog.get_logger("rcp.web")
_NOBODY = Principal("nobody", ())
_PATIENCE = 10.0  # s for a client to authenticate
_POLICY = 1008
_INTERNAL = 1011
_TRY_LATER = 1013
_UNTAKEN = "too many unread bytes"
_LAST = 32  # times the data sent per turn, before a connection is closed: 8 MiB
_TURN = 0.0005  # s of processing per client and turn; then others have theirs
_LEAST = 0.0002  # s guaranteed per client even if the total is used up: an e-stop takes less
_COUNTED = 0.00002  # s of processing per read below which it is not counted
_SHORT = 4096  # bytes of a message that is always accepted
_LOOK_EVERY = 32  # replies between checks whether the client reads them


class SocketClient(ABC):
    """The `Receiver` of one WebSocket, for the protocols that are spoken over one.

    A subclass handles messages (`_handle`) and words refusals. It calls `_gate.review` whenever it
    begins or ends something that later messages must wait for (`_waits`).
    """

    __slots__ = (
        "_backlog",
        "_began",
        "_gate",
        "_limit",
        "_look_at",
        "_outbox",
        "_patience",
        "_plain",
        "_socket",
        "_take",
        "_turn",
        "_turns",
        "_used",
        "connection",
        "gone",
    )

    ended: ClassVar[str] = "the session has ended"
    """The reason that a client is given when its session ends before its connection."""

    def __init__(
        self,
        client_api: ClientApi,
        who: tuple[Principal | None, str | None],
        encoding: Encoding,
        socket: NativeSocket,
        peer: Peer,
        backlog: int,
    ) -> None:
        """Connect a client: `who` has its principal, None if it must authenticate first, and its tenant.

        `backlog` is the number of queued replies above which reading pauses.
        """
        principal, tenant = who
        self._socket = socket
        self._turns = client_api.turns
        self.connection = client_api.connect(
            principal or _NOBODY, encoding, self.flush, tenant, peer
        )
        self._outbox = self.connection.outbox
        self._backlog = backlog
        self._look_at = min(_LOOK_EVERY, backlog)
        self._patience: asyncio.TimerHandle | None = None
        if principal is None:
            self._patience = client_api.loop.call_later(_PATIENCE, self._turn_away)
        self._take: Callable[[bytes], None] = self._handle
        """Called with each message; a subclass may save a call by setting it."""
        self._gate = ReadGate(
            socket,
            wait=self._wait,
            handle=self.received,
            settle=self.settled,
            full=self._full,
            failed=self._broken,
        )
        self._began = 0.0
        """Start of processing the current read, to all of which `settled` sends the replies; 0 between reads."""
        self._turn, self._used = 0, 0.0
        """Number of the current turn, and the time used in it."""
        self._plain = False
        """Whether the outbox has frames, and replies that can be sent as they are."""
        self.gone = asyncio.Event()
        self._limit = socket.limit = self.connection.limit

    @property
    def _authenticated(self) -> bool:
        return self.connection.session.principal is not _NOBODY

    def _identified(self) -> None:
        """Adopt what applies to a client that has said who it is."""
        if self._authenticated:
            self._end_patience()
        self._limit = self._socket.limit = self.connection.limit

    # -- receiving -----------------------------------------------------------------------------

    @abstractmethod
    def _handle(self, data: bytes) -> None:
        """Handle a message."""

    @abstractmethod
    def _failed(self, data: bytes, error: Exception) -> None:
        """Reply to a message that `_handle` raised an exception for."""

    @abstractmethod
    def oversized(self, size: int) -> None:
        """Reply to a message that was discarded because of its size."""

    @abstractmethod
    def garbled(self, data: bytes) -> None:
        """Reply to a text message that is not UTF-8, before the socket closes."""

    def _waits(self) -> bool:
        """Return whether a message is still being handled that later ones must wait for."""
        return False

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
            self._take(data)
        except Exception as error:
            # Otherwise the client would wait for its reply forever.
            self._failed(data, error)
        if len(outbox.control) >= self._look_at or outbox.waiting > BACKLOG_SHARE:
            self.flush()
            gate.review()
        elif size > _SHORT:
            gate.review()  # it may still be being handled
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
        still being handled, and `review` follows.
        """
        if self.connection.buffering or self._waits():
            return True
        outbox = self._outbox
        sends = outbox.control or not self._socket.writable or self._sending()
        return bool(sends) and (len(outbox.control) >= self._backlog or outbox.crowded)

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

    # -- sending -------------------------------------------------------------------------------

    def _send(self) -> None:
        """Send as much as one turn allows."""
        if not self._plain:
            self._send_messages()
        elif parts := self._outbox.collect():
            self._socket.write_frames(parts)

    def _send_messages(self) -> None:
        """Send as much as one turn allows, in messages that are not framed yet."""
        if messages := self._outbox.collect():
            self._socket.write(messages)

    def _sending(self) -> bool:
        """Return whether part of a message is still to be sent."""
        return False

    def flush(self) -> None:
        """Send pending data, if the socket accepts it."""
        socket, outbox = self._socket, self._outbox
        try:
            if self.connection.expelled:
                self._flush_last()
                return
            if socket.writable:
                self._send()
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

    def _flush_last(self) -> None:
        """Send the remaining data before the end, which may include its reason."""
        self._gate.close()
        outbox = self._outbox
        for _ in range(_LAST):
            self._send()
            if not (outbox.control or outbox.feedback or self._sending()):
                break
        self._close(_POLICY, self.ended)

    def drained(self) -> None:
        """Continue: the client is reading again."""
        self.flush()

    # -- the end -------------------------------------------------------------------------------

    @abstractmethod
    def _release(self) -> None:
        """Close the parts of the client, and its connection to the gateway."""

    def lost(self, code: int) -> None:
        """Release the connection."""
        self._end_patience()
        self._gate.close()
        self._release()
        self.gone.set()

    def _cut_off(self) -> None:
        """Close a client that does not read, to free its memory.

        It may never see the reason, because the close frame follows the data that it does not read.
        """
        session = self.connection.session
        log.warning(
            "websocket_cut",
            transport=session.transport,
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
        session = self.connection.session
        log.error(
            "websocket_failed", transport=session.transport, session=session.id, exc_info=error
        )
        self._close(_INTERNAL, "the gateway failed; see its log")

    def _close(self, code: int, reason: str) -> None:
        self._gate.close()
        self._socket.close(code, reason)
