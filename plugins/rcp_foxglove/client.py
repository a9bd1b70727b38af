"""One client: its messages in, the gateway's out, over the native handle of its WebSocket."""

from __future__ import annotations

from rcp_foxglove import operations as ops
from rcp_foxglove.assets import Assets
from rcp_foxglove.calls import Calls
from rcp_foxglove.config import FoxgloveConfig
from rcp_foxglove.frames import Call, Control, decode_frame, is_binary, time_frame
from rcp_foxglove.graph import ConnectionGraph
from rcp_foxglove.leases import Leases
from rcp_foxglove.news import News
from rcp_foxglove.parameters import Parameters
from rcp_foxglove.playback import Playback
from rcp_foxglove.publishing import Publishing
from rcp_foxglove.requests import Requests
from rcp_foxglove.server_info import ServerInfo
from rcp_foxglove.statuses import Statuses, refusal_text
from rcp_foxglove.subscriptions import Subscriptions
from rcp_foxglove.view_sender import ViewSender
from rcp_foxglove.views import View, Views
from rcp_gateway.api import Peer, Principal, to_internal_error
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import BadRequest, PayloadTooLarge, RcpError
from rcp_kernel.values import Encoding
from rcp_web.socket import NativeSocket
from rcp_web.socket_client import SocketClient

__all__ = ["FoxgloveClient"]

_BACKLOG = 256  # unread control messages above which reading pauses


class FoxgloveClient(SocketClient):
    """Hands each operation to the part that has it."""

    def __init__(
        self,
        client_api: ClientApi,
        config: FoxgloveConfig,
        views: Views,
        info: ServerInfo,
        who: tuple[Principal, str | None, Peer],
        socket: NativeSocket,
    ) -> None:
        principal, tenant, peer = who
        super().__init__(
            client_api, (principal, tenant), Encoding.JSON, socket, peer, backlog=_BACKLOG
        )
        self._client_api = client_api
        self._views = views
        self._info = info
        self._view: View | None = None
        self._renewing = False
        put = self._outbox.put
        self.statuses = Statuses(put, client_api.loop)
        self._requests = Requests(client_api, self.connection)
        self._leases = Leases(self._requests, config.lease)
        self._subscriptions = Subscriptions(client_api, self.connection, self.statuses, config)
        self._publishing = Publishing(self._requests, self._leases, self.statuses, config.valid_for)
        self._calls = Calls(self._requests, put, config.call_timeout)
        self._parameters = Parameters(self._requests, self.connection, self.statuses)
        self._graph = ConnectionGraph(put, f"client {self.connection.session.id[:8]}")
        self._assets = Assets(self._requests, put)
        self._sender = ViewSender(put)
        self.playback = Playback(
            self._requests, self.connection, self.statuses, self._send_time, self._announce
        )
        self._news = News(self.statuses, self._subscriptions, self._leases, client_api.loop)
        self._requests.on_room = self._gate.review
        self._outbox.translate(self._news)
        self.connection.set_callbacks(
            hello=lambda _hello: {}, released=self._gate.put_back, cut=self._cut_off
        )

    def opened(self, view: View) -> None:
        """Begin: say who serves, and what there is."""
        self._plain = not self._socket.compresses
        if self._plain:
            self._outbox.send_frames(self._socket.head, self._socket.pass_on)
        else:
            self._outbox.send_messages(long=True)
        self._view = view
        self._announce()
        self._sender.send(view)
        self.playback.follow()

    def _announce(self) -> None:
        """Say who serves, and which recording if it is one."""
        if self._view is not None:
            self._outbox.put(self._info.encoded(self.playback))

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
            await self.playback.renew(view)
        finally:
            self._renewing = False
        self._view = view
        self._sender.send(view)
        self._subscriptions.keep(set(view.channels))
        self._publishing.renew(view)
        self._parameters.renew(view)
        self._renew_graph()
        self.playback.follow()

    def _renew_graph(self) -> None:
        assert self._view is not None
        self._graph.renew(self._view, self._subscriptions.topics, self._publishing.topics)

    def send_time(self, nanoseconds: int) -> None:
        """Send the gateway's time, unless the client sees a recording's."""
        if not self.playback.active:
            self._send_time(nanoseconds)

    def _send_time(self, nanoseconds: int) -> None:
        """Send a time, unless the client has not read what it has."""
        if self._socket.writable and not self._outbox.more:
            self._outbox.put(time_frame(nanoseconds))

    # -- receiving -----------------------------------------------------------------------------

    def _handle(self, data: bytes) -> None:
        view = self._view
        if view is None or self.connection.closed:
            return
        if is_binary(data):
            frame = decode_frame(data)
            if isinstance(frame, Call):
                self._calls.call(frame, view)
            elif isinstance(frame, Control):
                self.playback.control(frame)
            else:
                self._publishing.publish(frame.channel, frame.payload)
        else:
            self._operate(ops.decode_operation(data), view)
        if self._requests.crowded:
            self._gate.review()

    def _failed(self, data: bytes, error: Exception) -> None:
        if isinstance(error, RcpError):
            self._client_api.refused("message", error.code)
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

    def _waits(self) -> bool:
        return self._requests.crowded

    def oversized(self, size: int) -> None:
        """Refuse a message that was discarded because of its size."""
        error = PayloadTooLarge(
            f"a message of {size} bytes is too long: the limit is {self._limit}",
            remedy="Send less at a time, or raise `limits.message` of the gateway.",
        )
        self.statuses.tell(refusal_text(error))

    def garbled(self, data: bytes) -> None:
        """Refuse a text that is not UTF-8, before the socket closes as WebSockets must."""
        self.statuses.tell(refusal_text(BadRequest("the text message is not UTF-8")))
        self.flush()

    def _release(self) -> None:
        """Close the connection: nothing of it can be resumed."""
        self._requests.close()
        self.statuses.close()
        self._news.close()
        self.playback.close()
        self.connection.close(resumable=False)
