"""One client: its messages in, the gateway's out, over the native handle of its WebSocket."""

from __future__ import annotations

import asyncio
from time import perf_counter
from typing import Any

import structlog

from rcp_foxglove import operations as ops
from rcp_foxglove.assets import Assets
from rcp_foxglove.calls import Calls
from rcp_foxglove.config import FoxgloveConfig
from rcp_foxglove.frames import Call, decode_frame, is_binary, time_frame
from rcp_foxglove.graph import ConnectionGraph
from rcp_foxglove.leases import Leases
from rcp_foxglove.news import News
from rcp_foxglove.parameters import Parameters
from rcp_foxglove.publishing import Publishing
from rcp_foxglove.requests import Requests
from rcp_foxglove.statuses import Statuses, refusal_text
from rcp_foxglove.subscriptions import Subscriptions
from rcp_foxglove.view_sender import ViewSender
from rcp_foxglove.views import View, Views
from rcp_kernel.api import BACKLOG_SHARE, Peer, Principal, to_internal_error
from rcp_kernel.client_api import ClientApi
from rcp_kernel.errors import BadRequest, PayloadTooLarge, RcpError
from rcp_kernel.values import Encoding
from rcp_web.read_gate import ReadGate
from rcp_web.socket import NativeSocket

__all__ = ["FoxgloveClient"]

log = structlog.get_logger("rcp.foxglove")
_POLICY, _INTERNAL, _TRY_LATER = 1008, 1011, 1013
_TURN = 0.0005  # s of processing per client and turn of the loop
_LEAST = 0.0002  # s of it even if the turn's time is used up
_COUNTED = 0.00002  # s of processing per read below which it is not counted
_LAST = 32  # writes before a connection is closed
_BACKLOG = 256  # unread control messages above which reading pauses


class FoxgloveClient:
    """Hands each operation to the part that has it."""

    def __init__(
        self,
        client_api: ClientApi,
        config: FoxgloveConfig,
        views: Views,
        who: tuple[Principal, str | None, Peer],
        socket: NativeSocket,
    ) -> None:
        principal, tenant, peer = who
        self._client_api = client_api
        self._views = views
        self._socket = socket
        self._turns = client_api.turns
        self._turn, self._used, self._began = 0, 0.0, 0.0
        self._view: View | None = None
        self._renewing = False
        self.gone = asyncio.Event()
        self.connection = client_api.connect(principal, Encoding.JSON, self.flush, tenant, peer)
        self._outbox = self.connection.outbox
        put = self._outbox.put
        self.statuses = Statuses(put, client_api.loop)
        self._requests = Requests(client_api, self.connection)
        self._leases = Leases(self._requests, config.lease)
        self._subscriptions = Subscriptions(
            client_api, self.connection, self.statuses, config.depth
        )
        self._publishing = Publishing(self._requests, self._leases, self.statuses, config.valid_for)
        self._calls = Calls(self._requests, put, config.call_timeout)
        self._parameters = Parameters(self._requests, self.connection, self.statuses, put)
        self._graph = ConnectionGraph(put, f"client {self.connection.session.id[:8]}")
        self._assets = Assets(self._requests, put)
        self._sender = ViewSender(put)
        self._news = News(self.statuses, self._subscriptions, self._leases, client_api.loop)
        self._gate = ReadGate(
            socket,
            wait=self._wait,
            handle=self.received,
            settle=self.settled,
            full=self._full,
            failed=self._broken,
        )
        self._requests.on_room = self._gate.review
        self._outbox.translate(self._news)
        self.connection.set_callbacks(
            hello=lambda _hello: {}, released=self._gate.put_back, cut=self._cut_off
        )
        socket.limit = self.connection.limit

    def opened(self, server_info: bytes, view: View) -> None:
        """Begin: say who serves, and what there is."""
        if self._socket.compresses:
            self._outbox.send_messages(long=True)
        else:
            self._outbox.send_frames(self._socket.head, self._socket.pass_on)
        self._outbox.put(server_info)
        self._view = view
        self._sender.send(view)

    # -- the tree ------------------------------------------------------------------------------

    def look(self) -> None:
        """Send what has changed in the client's view of the tree."""
        view = self._view
        if view is None or self._renewing or self.connection.closed:
            return
        if not self._views.is_current(self.connection.session, view):
            self._renewing = True
            self._requests.begin(self._renew())

    async def _renew(self) -> None:
        try:
            view = await self._views.view(self.connection.session)
        finally:
            self._renewing = False
        self._view = view
        self._sender.send(view)
        self._subscriptions.keep(set(view.channels))
        self._publishing.renew(view)
        self._parameters.renew(view)
        self._renew_graph()

    def _renew_graph(self) -> None:
        assert self._view is not None
        self._graph.renew(self._view, self._subscriptions.topics, self._publishing.topics)

    def send_time(self, nanoseconds: int) -> None:
        """Send the time, unless the client has not read what it has."""
        if self._socket.writable and not self._outbox.more:
            self._outbox.put(time_frame(nanoseconds))

    # -- receiving -----------------------------------------------------------------------------

    def received(self, data: bytes, text: bool = True) -> None:  # noqa: FBT001, FBT002 - see Receiver
        """Handle a message, or keep it until the client's next turn."""
        gate = self._gate
        if not gate.handing and (gate.paused or (self._began and self._over())):
            gate.keep(data)
            if not gate.paused:
                gate.end_turn()
            return
        if not self._began:
            self._began = perf_counter()
            self._outbox.dirty = True  # no tick: `settled` sends the replies
        if len(data) > self.connection.limit:
            self.oversized(len(data))
        else:
            self._handle(data)
        if len(self._outbox.control) >= _BACKLOG or self._outbox.waiting > BACKLOG_SHARE:
            self.flush()
            gate.review()
        if gate.handing and self._over():
            gate.end_turn()

    def _handle(self, data: bytes) -> None:
        view = self._view
        if view is None or self.connection.closed:
            return
        try:
            if is_binary(data):
                frame = decode_frame(data)
                if isinstance(frame, Call):
                    self._calls.call(frame, view)
                else:
                    self._publishing.publish(frame.channel, frame.payload)
            else:
                self._operate(ops.decode_operation(data), view)
        except RcpError as error:
            self._client_api.refused("message", error.code)
            self.statuses.tell(refusal_text(error))
        except Exception as error:
            self.statuses.tell(refusal_text(to_internal_error(error)))

    def _operate(self, operation: ops.Operation, view: View) -> None:
        match operation:
            case ops.Subscribe():
                for wish in operation.subscriptions:
                    self._subscriptions.begin(wish, view)
                self._renew_graph()
            case ops.Unsubscribe():
                for number in operation.subscription_ids:
                    self._subscriptions.end(number)
                self._renew_graph()
            case ops.Advertise():
                for channel in operation.channels:
                    self._publishing.advertise(channel, view)
                self._renew_graph()
            case ops.Unadvertise():
                for number in operation.channel_ids:
                    self._publishing.unadvertise(number)
                self._renew_graph()
            case ops.GetParameters():
                self._parameters.get(operation.parameter_names, operation.id, view)
            case ops.SetParameters():
                self._parameters.set(operation.parameters, operation.id, view)
            case ops.SubscribeParameterUpdates():
                self._parameters.follow(operation.parameter_names, view)
            case ops.UnsubscribeParameterUpdates():
                self._parameters.unfollow(operation.parameter_names)
            case ops.SubscribeConnectionGraph():
                topics = self._subscriptions.topics, self._publishing.topics
                self._graph.follow(view, *topics)
            case ops.UnsubscribeConnectionGraph():
                self._graph.unfollow()
            case ops.FetchAsset():
                self._assets.fetch(operation, view)

    def _over(self) -> bool:
        """Return whether the messages of the present read have used up the client's turn."""
        spent = perf_counter() - self._began
        return spent > _LEAST and (spent > _TURN or self._turns.over)

    def other_frame(self) -> None:
        """Count the time of a frame that is not a whole message."""
        if not self._began:
            self._began = perf_counter()
            self._outbox.dirty = True
        elif perf_counter() - self._began > _TURN:
            self._gate.end_turn()

    def _wait(self, go_on: Any) -> None:
        self._turns.call(self.connection.session.principal.identity, go_on)

    def _full(self) -> bool:
        """Return whether reading must pause: the client does not read what it is sent, or waits."""
        outbox = self._outbox
        if self._requests.crowded:
            return True
        sends = outbox.control or not self._socket.writable
        return bool(sends) and (len(outbox.control) >= _BACKLOG or outbox.crowded)

    def settled(self) -> None:
        """Send what the messages of one read have led to."""
        began, self._began = self._began, 0.0
        outbox = self._outbox
        outbox.dirty = outbox.begins = False
        self.flush()
        if began and not self._gate.handing and (spent := perf_counter() - began) > _COUNTED:
            self._count(spent)

    def _count(self, seconds: float) -> None:
        turns = self._turns
        turns.add(seconds)
        if self._turn != turns.number:
            self._turn, self._used = turns.number, 0.0
        self._used += seconds
        if self._used > _LEAST and (self._used > _TURN or turns.over):
            self._gate.end_turn()

    def oversized(self, size: int) -> None:
        """Refuse a message that was discarded because of its size."""
        limit = self.connection.limit
        error = PayloadTooLarge(
            f"a message of {size} bytes is too long: the limit is {limit}",
            remedy="Send less at a time, or raise `limits.message` of the gateway.",
        )
        self.statuses.tell(refusal_text(error))

    def garbled(self, data: bytes) -> None:
        """Refuse a text that is not UTF-8, before the socket closes as WebSockets must."""
        self.statuses.tell(refusal_text(BadRequest("the text message is not UTF-8")))
        self.flush()

    # -- sending -------------------------------------------------------------------------------

    def flush(self) -> None:
        """Send what waits, as far as the client reads."""
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
                outbox.again()
            if self._gate.paused:
                self._gate.review()
        except Exception as error:
            self._broken(error)

    def _send(self) -> None:
        parts = self._outbox.collect()
        if not parts:
            return
        if self._socket.compresses:
            self._socket.write(parts)
        else:
            self._socket.write_frames(parts)

    def _flush_last(self) -> None:
        self._gate.close()
        for _ in range(_LAST):
            self._send()
            if not self._outbox.control:
                break
        self._close(_POLICY, "the session has ended")

    def drained(self) -> None:
        """Continue: the client reads again."""
        self.flush()

    # -- the end -------------------------------------------------------------------------------

    def _cut_off(self) -> None:
        log.warning("foxglove_cut", principal=self.connection.session.principal.name)
        self._close(_TRY_LATER, "too many unread bytes")

    def _broken(self, error: Exception) -> None:
        log.error("foxglove_failed", session=self.connection.session.id[:8], exc_info=error)
        self._close(_INTERNAL, "the gateway failed; see its log")

    def _close(self, code: int, reason: str) -> None:
        self._gate.close()
        self._socket.close(code, reason)

    def lost(self, code: int) -> None:
        """Release the connection: nothing of it can be resumed."""
        self._gate.close()
        self._requests.close()
        self.statuses.close()
        self._news.close()
        self.connection.close(resumable=False)
        self.gone.set()
