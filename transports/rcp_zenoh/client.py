"""One link of a hub: connects its pipe to its connection to the gateway."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import structlog
import zenoh

from rcp_kernel.api import Hello, Peer, Principal
from rcp_kernel.client_api import ClientApi
from rcp_kernel.errors import PayloadTooLarge, Unauthenticated
from rcp_kernel.values import Encoding
from rcp_kernel.wire import failure, peek_header
from rcp_zenoh.pipe import Pipe

__all__ = ["HubLink"]

log = structlog.get_logger("rcp.zenoh")
_NOBODY = Principal("nobody", ())


class HubLink:
    """Passes messages to the connection, and the contents of the outbox to the pipe."""

    def __init__(
        self,
        client_api: ClientApi,
        session: zenoh.Session,
        key: str,
        patience: float,
        gone: Callable[[], object],
    ) -> None:
        self._gone = gone
        self._pipe = Pipe(session, key, self.flush, self._ended)
        self._connection = client_api.connect(_NOBODY, Encoding.MSGPACK, self.flush, peer=Peer())
        self._connection.set_callbacks(
            hello=self._hello,
            released=self._released,
            cut=lambda: self.close("the hub does not read"),
        )
        self._known = False
        self._patience = client_api.loop.call_later(
            patience, self.close, "the hub did not say who it is"
        )

    def received(self, sample: zenoh.Sample) -> None:
        """Handle a message of the hub."""
        data = self._pipe.receive(sample)
        if data is None:
            return
        limit = self._connection.limit
        if len(data) > limit:
            error = PayloadTooLarge(
                f"the message is longer than {limit} bytes", details={"limit": limit}
            )
            self._connection.send(failure(error, "error"))
            return
        if not self._known and not self._connection.holds:
            type_, id_ = peek_header(data, Encoding.MSGPACK)
            if type_ != "hello":
                refusal = Unauthenticated("authentication required")
                self._connection.send(failure(refusal, type_, id_))
                return
        self._connection.receive(data)

    def _released(self, held: deque[bytes]) -> None:
        for data in held:
            self._connection.receive(data)

    def _hello(self, hello: Hello) -> dict[str, object]:
        if self._connection.session.principal is not _NOBODY:
            self._known = True
            self._patience.cancel()
        return {}

    def flush(self) -> None:
        """Send pending data while there is room in the window."""
        outbox = self._connection.outbox
        if self._pipe.writable:
            for message in outbox.collect():
                self._pipe.send(message)
        outbox.hand(self._pipe.buffered)
        if self._connection.expelled:
            self.close("the session has ended or moved to another link")
        elif self._pipe.writable:
            outbox.again()

    def close(self, why: str) -> None:
        """End the link; its session waits for the hub to return."""
        self._pipe.end(why)

    def _ended(self, why: str) -> None:
        log.info("zenoh_link_ended", session=self._connection.session.id[:8], reason=why)
        self._patience.cancel()
        self._connection.close()
        self._gone()
