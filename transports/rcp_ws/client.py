"""One client: connects its WebSocket to its connection to the gateway."""

from __future__ import annotations

from typing import Any

from rcp_gateway.api import Hello, Peer, Principal
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import BadRequest, PayloadTooLarge, RcpError, Unauthenticated
from rcp_kernel.values import Encoding
from rcp_kernel.wire import failure, peek_header
from rcp_web.socket import NativeSocket
from rcp_web.socket_client import SocketClient
from rcp_ws import segments
from rcp_ws.config import WsConfig
from rcp_ws.incoming import Incoming
from rcp_ws.outgoing import Outgoing
from rcp_ws.segments import Again

__all__ = ["WsClient"]

_SEGMENT = b"segment"  # only a message with this word can be a segment


class WsClient(SocketClient):
    """Passes messages to the connection, and the contents of the outbox to the socket."""

    __slots__ = ("_config", "_encoding", "_incoming", "_outgoing")

    ended = "the session has ended or moved to another connection"

    def __init__(
        self,
        client_api: ClientApi,
        config: WsConfig,
        who: tuple[Principal | None, str | None],
        encoding: Encoding,
        socket: NativeSocket,
        peer: Peer,
    ) -> None:
        super().__init__(client_api, who, encoding, socket, peer, config.backlog)
        self._config = config
        self._encoding = encoding
        if self._authenticated:
            self._admit()
        self.connection.set_callbacks(
            hello=self._hello, released=self._gate.put_back, cut=self._cut_off
        )
        self._incoming = Incoming(config, whole=self._whole, again=self._again, failed=self._fail)
        self._incoming.limit = self._limit
        room = client_api.limits.queue_bytes // 4
        park = self._outbox.park
        self._outgoing = Outgoing(encoding, config.kept, room, client_api.loop, park)

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

    def _admit(self) -> None:
        """Take all messages of a client that is authenticated, and reassemble its segments."""
        self._take = self.connection.receive
        self.connection.on_other = self._segment

    # -- receiving -----------------------------------------------------------------------------

    def _failed(self, data: bytes, error: Exception) -> None:
        self.connection.answer_internal_error(data, error)

    def _handle(self, data: bytes) -> None:
        """Accept only `hello` from a client that is not authenticated."""
        type_, id_ = peek_header(data, self._encoding)
        if type_ != "hello" and not self.connection.buffering:
            error = Unauthenticated("authentication required")
            self.connection.send(failure(error, type_, id_))
            return
        self.connection.receive(data)

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

    def _release(self) -> None:
        """Close the connection; its session waits for the client to return."""
        self._incoming.close()
        self._outgoing.close()
        self.connection.close()

    # -- segments ------------------------------------------------------------------------------

    def _segment(self, data: bytes) -> bool:
        """Handle a message that may be a segment; return whether it was one."""
        if _SEGMENT not in data:
            return False
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
        self._take(data)

    def _fail(self, id_: str | int | None, error: RcpError) -> None:
        self.connection.send(failure(error, "segment", None if id_ is None else str(id_)))

    def _again(self, id_: str | int, missing: list[int]) -> None:
        self._outbox.put(segments.request_again(id_, missing, self._encoding))

    def _hello(self, hello: Hello) -> dict[str, Any]:
        self._identified()
        self._incoming.limit = self._limit
        if self._authenticated:
            self._admit()
        wanted = hello.segment_size
        agreed = None if wanted is None else min(wanted, self._config.segment_size)
        self._outgoing.size = agreed
        self._agree()
        return {"limits": {"segment_size": agreed, "segments": self._config.segments}}

    # -- sending -------------------------------------------------------------------------------

    def _send_messages(self) -> None:
        """Send as much as one turn allows, compressed or in segments."""
        if self._outgoing.size is not None:
            self._flush_cut(self._outgoing, self._outgoing.size)
        else:
            super()._send_messages()

    def _sending(self) -> bool:
        return self._outgoing.busy

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
