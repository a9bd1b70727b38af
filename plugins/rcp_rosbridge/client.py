"""One client: connects its WebSocket to its connection to the gateway."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

import msgspec

from rcp_gateway.api import (
    LONG_MESSAGE,
    Hello,
    Peer,
    Principal,
    check_structure,
    to_internal_error,
)
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import (
    BadRequest,
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
from rcp_rosbridge.notices import Notices, tell_outcome
from rcp_rosbridge.offered_calls import OfferedCalls
from rcp_rosbridge.offering import Offering
from rcp_rosbridge.png_reader import read_png
from rcp_rosbridge.publishing import Publishing
from rcp_rosbridge.status import StatusMessages, sentence
from rcp_rosbridge.subscriptions import MARK, Subscriptions
from rcp_web.socket import NativeSocket
from rcp_web.socket_client import SocketClient

__all__ = ["RosClient"]

_BACKLOG = 256  # messages queued for a client before it is not read from
_OWN = b'{"type":'  # how replies of the gateway itself begin
Operate = Callable[[Any], None]


class RosClient(SocketClient):
    """Passes operations on, and the contents of the outbox to the socket."""

    ended = "the session has ended: the credentials may have expired"

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
        known = tenant if principal is not None else None
        super().__init__(
            client_api, (principal, known), Encoding.JSON, socket, peer, backlog=_BACKLOG
        )
        self._client_api = client_api
        self._tenant = tenant
        self._session = self.connection.session
        self.connection.set_callbacks(
            hello=self._hello, released=self._gate.put_back, cut=self._cut_off
        )
        status = StatusMessages(config.status, self._outbox.put, client_api.loop.time)
        context = Context(client_api, config, self.connection, graphs, renderings, status)
        self._status = status
        self._subscriptions = Subscriptions(context, self._agree)
        leases = Leases(context)
        self._outbox.translate(Notices(status, leases.lost, self._subscriptions.note_missed))
        self._publishing = Publishing(context, leases)
        self._calls = Calls(context)
        offered = OfferedCalls(context)
        offering = Offering(context, offered)
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
            op.AdvertiseService: offering.advertise_service,
            op.UnadvertiseService: offering.unadvertise_service,
            op.ServiceResponse: offered.respond,
            op.AdvertiseAction: offering.advertise_action,
            op.UnadvertiseAction: offering.unadvertise_action,
            op.ActionFeedback: offered.feedback,
            op.ActionResult: offered.finish,
            op.Fragment: self._fragment,
            op.Png: self._png,
            op.SetLevel: self._set_level,
            op.Status: _ignore,
            op.Auth: self._authenticate,
        }
        self._long = 0
        """Number of long messages, and of messages in them, that are being decoded: later ones wait."""
        self._asked = 0
        """Number of `auth` operations without an outcome."""

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

    def _handle(self, data: bytes) -> None:
        if len(data) > LONG_MESSAGE:
            self._take_long(data)
        else:
            self._operate(data)
        if self._long or self.connection.buffering:
            self._gate.review()

    def _failed(self, data: bytes, error: Exception) -> None:
        self._complain(to_internal_error(error), data)

    def _waits(self) -> bool:
        return self._long > 0

    def _take_long(self, data: bytes) -> None:
        """Decode a message when its turn has come, and before all later ones."""
        self._in_turn(self._unfold(data), data)

    def _in_turn(self, work: Generator[None], data: bytes) -> None:
        self._long += 1
        try:
            owner = self.connection.session.principal.identity
            self._turns.run(owner, self._contained(work, data), len(data))
        except RcpError:
            self._long -= 1
            raise

    def _contained(self, work: Generator[None], data: bytes) -> Generator[None]:
        try:
            yield from work
        except Exception as error:
            self._complain(to_internal_error(error), data)
        self._long -= 1
        self._gate.review()

    def _unfold(self, data: bytes) -> Generator[None]:
        yield from check_structure(data, Encoding.JSON, self._client_api.limits.values)
        if not self.connection.closed:
            self._operate(data)

    def _png(self, picture: op.Png) -> None:
        """Read a picture when its turn has come, and before all later messages."""
        self._in_turn(self._develop(picture.data), b"")

    def _develop(self, picture: str) -> Generator[None]:
        data = yield from read_png(picture)
        if isinstance(op.decode(data), op.Png):
            raise BadRequest("a picture of a picture is no operation")
        yield from self._unfold(data)

    def _operate(self, data: bytes | str) -> None:
        operation = op.decode(data)
        kind: type[Any] = type(operation)
        if not self._authenticated and kind not in (op.Auth, op.SetLevel):
            raise Unauthenticated(
                "authentication required",
                remedy='Send {"op": "auth", "token": …} first, or an Authorization header.',
            )
        self._operations[kind](operation)

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
        self._asked += 1
        self.connection.receive(msgspec.json.encode(envelope))

    def _hello(self, _hello: Hello) -> dict[str, Any]:
        self._identified()
        if self.connection.session is not self._session:  # it has no subscriptions yet
            self._session = self.connection.session
            self._client_api.loop.call_soon(self._subscriptions.renew)
        return {}

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

    # -- sending -------------------------------------------------------------------------------

    def settled(self) -> None:
        """Send the replies to the messages of one read."""
        self._tell_outcomes()
        super().settled()

    def flush(self) -> None:
        """Send pending data, if the socket accepts it."""
        super().flush()
        if not self._socket.writable:
            self._subscriptions.note_missed()

    def _send(self) -> None:
        self._tell_outcomes()
        super()._send()

    def _send_messages(self) -> None:
        out: list[bytes] = []
        for message in self._outbox.collect():
            out += self._subscriptions.pack(message) if message[0] == MARK else (message,)
        if out:
            self._socket.write(out)

    def _tell_outcomes(self) -> None:
        """Replace the gateway's replies to `auth` by what a client of rosbridge understands."""
        if not self._asked:
            return
        outbox = self._outbox
        waiting, outbox.control = outbox.control, []
        for data in waiting:
            if data.startswith(_OWN):
                outbox.waiting -= len(data)
                self._asked -= 1
                tell_outcome(data, self._status)
            else:
                outbox.control.append(data)

    def _release(self) -> None:
        """Close the connection and its session: clients of rosbridge cannot resume one."""
        self._subscriptions.close()
        self._publishing.close()
        self._assembly.close()
        self.connection.close(resumable=False)


def _ignore(_operation: Any) -> None:
    """Do nothing: what a client says of itself concerns nobody."""
