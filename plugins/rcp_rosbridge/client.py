"""One client: connects its WebSocket to its connection to the gateway."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Generator
from time import perf_counter
from typing import Any

import msgspec
import structlog

from rcp_kernel.api import (
    BACKLOG_SHARE,
    LONG_MESSAGE,
    Hello,
    Peer,
    Principal,
    check_structure,
    to_internal_error,
)
from rcp_kernel.client_api import ClientApi
from rcp_kernel.errors import (
    NotImplementedByRobot,
    PayloadTooLarge,
    RcpError,
    SegmentMissing,
    Unauthenticated,
)
from rcp_kernel.values import Encoding
from rcp_rosbridge import operations as op
from rcp_rosbridge.calls import Calls
from rcp_rosbridge.config import RosbridgeConfig
from rcp_rosbridge.context import Context
from rcp_rosbridge.dialects import Renderings
from rcp_rosbridge.fragments import Assembly
from rcp_rosbridge.graphs import Graphs
from rcp_rosbridge.leases import Leases
from rcp_rosbridge.notices import explained
from rcp_rosbridge.publishing import Publishing
from rcp_rosbridge.status import StatusMessages, sentence
from rcp_rosbridge.subscriptions import MARK, Subscriptions
from rcp_web.read_gate import ReadGate
from rcp_web.socket import NativeSocket

__all__ = ["RosClient"]

log = structlog.get_logger("rcp.rosbridge")
_NOBODY = Principal("nobody", ())
_PATIENCE = 10.0  # s for a client to authenticate
_POLICY = 1008
_INTERNAL = 1011
_TRY_LATER = 1013
_TURN = 0.0005  # s of processing per client and turn; then others have theirs
_LEAST = 0.0002  # s guaranteed per client even if the total is used up: a stop takes less
_SHORT = 4096  # bytes of a message that is always accepted
_BACKLOG = 256  # messages queued for a client before it is not read from
_OWN = b'{"type":'  # how messages of the gateway itself begin
_LAST = 32  # times the data sent per turn, before a connection is closed
Operate = Callable[[Any], None]


class RosClient:
    """Passes operations on, and the contents of the outbox to the socket."""

    def __init__(
        self,
        client_api: ClientApi,
        config: RosbridgeConfig,
        who: tuple[Principal | None, str | None],
        socket: NativeSocket,
        peer: Peer,
        graphs: Graphs,
        renderings: Renderings,
    ) -> None:
        principal, tenant = who
        self._client_api = client_api
        self._socket = socket
        self._turns = client_api.turns
        self._known = principal is not None
        self._tenant = tenant
        self.connection = client_api.connect(
            principal or _NOBODY,
            Encoding.JSON,
            self.flush,
            tenant if self._known else None,
            peer,
        )
        self._outbox = self.connection.outbox
        self._session = self.connection.session
        self._gate = ReadGate(
            socket,
            wait=self._wait,
            handle=self.received,
            settle=self.settled,
            full=self._full,
            failed=self._broken,
        )
        self.connection.set_callbacks(hello=self._hello, released=self._released, cut=self._cut_off)
        self._patience: asyncio.TimerHandle | None = None
        if not self._known:
            self._patience = client_api.loop.call_later(_PATIENCE, self._turn_away)
        status = StatusMessages(config.status, self._outbox.put, client_api.loop.time)
        context = Context(client_api, config, self.connection, graphs, renderings, status)
        self._status = status
        self._subscriptions = Subscriptions(context, self._agree)
        self._leases = Leases(context)
        self._publishing = Publishing(context, self._leases)
        self._calls = Calls(context)
        self._assembly = Assembly(client_api.loop, config.fragment_timeout, self._fragment_lost)
        self._operations: dict[type[Any], Operate] = {
            op.Publish: self._publishing.publish,
            op.Advertise: self._publishing.advertise,
            op.Unadvertise: self._publishing.unadvertise,
            op.Subscribe: self._subscriptions.subscribe,
            op.Unsubscribe: self._subscriptions.unsubscribe,
            op.CallService: self._calls.call,
            op.SendActionGoal: self._calls.send_goal,
            op.CancelActionGoal: self._calls.cancel_goal,
            op.Fragment: self._fragment,
            op.SetLevel: self._set_level,
            op.Status: _ignore,
            op.Auth: self._authenticate,
        }
        self._long = False
        """Whether a long message is being decoded, for which later ones wait."""
        self._began = 0.0
        self._turn, self._used = 0, 0.0
        self._limit = socket.limit = self.connection.limit
        self._plain = False
        """Whether updates are sent as frames that clients share."""
        self.gone = asyncio.Event()

    def opened(self) -> None:
        """Apply the result of the handshake."""
        self._agree()

    def _agree(self) -> None:
        socket = self._socket
        self._plain = not (socket.compresses or self._subscriptions.packs)
        if self._plain:
            self._outbox.send_frames(socket.head, socket.pass_on)
        else:
            self._outbox.send_messages()

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
        if not self._began:
            self._began = perf_counter()
        try:
            if size > LONG_MESSAGE:
                self._take_long(data)
            else:
                self._operate(data)
        except Exception as error:
            self._complain(to_internal_error(error), data)
        if len(self._outbox.control) >= _BACKLOG or self._outbox.waiting > BACKLOG_SHARE:
            self.flush()
        if self._full():
            gate.review()
        if gate.handing and self._over():
            gate.end_turn()

    def _take_long(self, data: bytes) -> None:
        """Decode a message when its turn has come, and before all later ones."""
        self._long = True
        try:
            owner = self.connection.session.principal.identity
            self._turns.run(owner, self._unfold(data), len(data))
        except RcpError:
            self._long = False
            raise

    def _unfold(self, data: bytes) -> Generator[None]:
        try:
            yield from check_structure(data, Encoding.JSON, self._client_api.limits.values)
            if not self.connection.closed:
                self._operate(data)
        except Exception as error:
            self._complain(to_internal_error(error), data)
        self._long = False
        self._gate.review()

    def _operate(self, data: bytes | str) -> None:
        operation = op.decode(data)
        kind: type[Any] = type(operation)
        if not self._known and kind not in (op.Auth, op.SetLevel):
            raise Unauthenticated(
                "authentication required",
                remedy='Send {"op": "auth", "token": …} first, or an Authorization header.',
            )
        operate = self._operations.get(kind)
        if operate is None:
            name = kind.__struct_config__.tag
            raise NotImplementedByRobot(
                f"`{name}` is not supported", remedy="Offer it by a node of the robot."
            )
        operate(operation)

    def _complain(self, error: RcpError, data: bytes | str) -> None:
        self._client_api.refused("rosbridge", error.code)
        self._status.error(sentence(error), op.id_of(data), f"operation {error.code}")

    def _fragment(self, fragment: op.Fragment) -> None:
        whole = self._assembly.take(fragment, self._limit)
        if whole is None:
            return
        data = whole.encode()
        if len(data) > LONG_MESSAGE:
            self._take_long(data)
        else:
            self._operate(data)

    def _fragment_lost(self, id_: str, error: SegmentMissing) -> None:
        self._status.error(sentence(error), id_)

    def _set_level(self, operation: op.SetLevel) -> None:
        self._status.level = operation.level

    def _authenticate(self, operation: op.Auth) -> None:
        """Say `hello` for the client; messages that follow wait for the outcome."""
        hello: dict[str, Any] = {"token": operation.token or operation.mac}
        if hello["token"] is None:
            raise Unauthenticated("there is no token", remedy="Send it as `token`, or as `mac`.")
        if self._tenant is not None:
            hello["tenant"] = self._tenant
        id_ = "" if operation.id_ is None else str(operation.id_)
        envelope = {"type": "hello", "id": f"auth:{id_}"[:128], "body": hello}
        self.connection.receive(msgspec.json.encode(envelope))

    def _hello(self, _hello: Hello) -> dict[str, Any]:
        self._known = self.connection.session.principal is not _NOBODY
        if self._known and self._patience is not None:
            self._patience.cancel()
            self._patience = None
        self._limit = self._socket.limit = self.connection.limit
        if self.connection.session is not self._session:  # it has no subscriptions yet
            self._session = self.connection.session
            self._client_api.loop.call_soon(self._subscriptions.renew)
        return {}

    def _released(self, messages: deque[bytes]) -> None:
        """Go on reading: the outcome of an authentication is known."""
        self._gate.put_back(messages)

    def _over(self) -> bool:
        """Return whether the messages of the current read have used up the client's turn."""
        spent = perf_counter() - self._began
        return spent > _LEAST and (spent > _TURN or self._turns.over)

    def other_frame(self) -> None:
        """Count the time of a frame that is not a whole message."""
        if not self._began:
            self._began = perf_counter()
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
        """Return whether reading from the client must pause until `review` is called."""
        if self._long or self.connection.buffering:
            return True
        outbox = self._outbox
        sends = outbox.control or not self._socket.writable
        return bool(sends) and (len(outbox.control) >= _BACKLOG or outbox.crowded)

    def settled(self) -> None:
        """Count the time of one read."""
        began, self._began = self._began, 0.0
        if began and not self._gate.handing:
            self._count(perf_counter() - began)

    def garbled(self, data: bytes) -> None:
        """Tell that a text message is not UTF-8, before the socket closes."""
        self._status.error("the text message is not UTF-8, so the connection is closed")
        self.flush()

    def oversized(self, size: int) -> None:
        """Tell that a message was discarded because of its size."""
        error = PayloadTooLarge(
            f"the message is longer than {self._limit} bytes, and was dropped",
            details={"limit": self._limit},
        )
        self._status.error(sentence(error), None, "oversized")

    # -- the end -------------------------------------------------------------------------------

    def _cut_off(self) -> None:
        """Close a client that does not read, to free its memory."""
        self._close(_TRY_LATER, "too many unread bytes")

    def _turn_away(self) -> None:
        self._close(_POLICY, "not authenticated")

    def _broken(self, error: Exception) -> None:
        """Close a connection after an internal error: its data may have gaps."""
        log.error("rosbridge_failed", session=self.connection.session.id, exc_info=error)
        self._close(_INTERNAL, "the gateway failed; see its log")

    def _close(self, code: int, reason: str) -> None:
        self._gate.close()
        self._socket.close(code, reason)

    def lost(self, code: int) -> None:
        """Release the connection and its session: clients of rosbridge cannot resume one."""
        if self._patience is not None:
            self._patience.cancel()
        self._gate.close()
        self._subscriptions.close()
        self._publishing.close()
        self._assembly.close()
        self.connection.close(resumable=False)
        self.gone.set()

    # -- sending -------------------------------------------------------------------------------

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
                self._subscriptions.note_missed()
            else:
                if outbox.buffered:
                    outbox.hand(0)
                if outbox.control or outbox.feedback or outbox.pending:
                    outbox.again()
            if self._gate.paused:
                self._gate.review()
        except Exception as error:
            self._broken(error)

    def _send(self) -> None:
        socket, outbox = self._socket, self._outbox
        if outbox.control:
            self._explain()
        if self._plain:
            if parts := outbox.collect():
                socket.write_frames(parts)
        elif messages := outbox.collect():
            out: list[bytes] = []
            for message in messages:
                out += self._subscriptions.pack(message) if message[0] == MARK else (message,)
            if out:
                socket.write(out)

    def _explain(self) -> None:
        """Replace the gateway's own messages by what a client of rosbridge understands."""
        outbox = self._outbox
        waiting, outbox.control = outbox.control, []
        for data in waiting:
            if data.startswith(_OWN):
                outbox.waiting -= len(data)
                explained(data, self._status, self._leases.lost)
            else:
                outbox.control.append(data)

    def _flush_last(self) -> None:
        """Send the remaining data before the end, which may include its reason."""
        self._gate.close()
        outbox = self._outbox
        for _ in range(_LAST):
            self._send()
            if not (outbox.control or outbox.feedback):
                break
        self._close(_POLICY, "the session has ended: the credentials may have expired")

    def drained(self) -> None:
        """Continue: the client is reading again."""
        self.flush()


def _ignore(_operation: Any) -> None:
    """Do nothing: what a client says of itself concerns nobody."""
