"""One link of a hub: connects its pipe to its connection to the gateway."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import structlog
import zenoh

from rcp_gateway.api import Hello, Principal
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import PayloadTooLarge, Unauthenticated
from rcp_kernel.values import Encoding
from rcp_kernel.wire import failure, peek_header
from rcp_zenoh.budget import Allowance
from rcp_zenoh.classifier import Classifier
from rcp_zenoh.config import ZenohConfig
from rcp_zenoh.lane import WHOLE, Priority
from rcp_zenoh.pipe import Message, Pipe
from rcp_zenoh.statistics import LinkStatistics

__all__ = ["HubLink"]

log = structlog.get_logger("rcp.zenoh")
_BUDGET = 262_144  # bytes collected at once
_NOBODY = Principal("nobody", ())


class HubLink:
    """Passes messages to the connection, and the contents of the outbox to the pipe."""

    def __init__(
        self,
        client_api: ClientApi,
        session: zenoh.Session,
        key: str,
        declare: Callable[[str], zenoh.KeyExpr | None],
        encoding: Encoding,
        config: ZenohConfig,
        allowance: Allowance,
        statistics: LinkStatistics,
        gone: Callable[[], object],
    ) -> None:
        self._key, self._declare = key, declare
        self._gone, self._statistics, self._allowance = gone, statistics, allowance
        self._encoding, self._classifier = encoding, Classifier(encoding)
        self._paused = False
        """Whether updates stay in the outbox, where they are conflated."""
        principal = _NOBODY if client_api.requires_authentication else client_api.authenticate(None)
        self.known = False
        """Whether its hub has said who it is, or need not."""
        self._connection = client_api.connect(principal, encoding, self.flush, wraps=True)
        self._pipe = Pipe(session, key, config.silence, self, allowance, self._note)
        self._connection.set_callbacks(
            hello=self._hello,
            released=self._released,
            cut=lambda: self.close("the hub does not read"),
        )
        if principal is not _NOBODY:
            self._prove()
        self._patience = client_api.loop.call_later(config.patience, self._turn_away)
        statistics.opened(self._pipe)

    @property
    def longest(self) -> int:
        """Longest message that the hub may send now."""
        return self._connection.limit

    def _prove(self) -> None:
        """Declare the key, which nobody else can make the gateway do: Zenoh has few numbers."""
        if self.known:
            return
        self.known = True
        if (key := self._declare(self._key)) is not None:
            self._pipe.declare(key)

    def _turn_away(self) -> None:
        if not self.known:
            self.close("the hub did not say who it is")

    def received(self, sample: zenoh.Sample) -> None:
        """Handle a message of the hub."""
        message = self._pipe.receive(sample)
        if message is not None:
            self._take(message)

    def _take(self, message: Message) -> None:
        data, limit = message.data, self.longest
        if data is None or len(data) > limit:
            error = PayloadTooLarge(
                f"the message is longer than {limit} bytes", details={"limit": limit}
            )
            self._connection.send(failure(error, "error"))
            return
        if not self.known and not self._connection.buffering:
            type_, id_ = peek_header(data, self._encoding)
            if type_ != "hello":
                refusal = Unauthenticated("authentication required")
                self._connection.send(failure(refusal, type_, id_))
                return
        if message.priority is Priority.STOP:
            self._classifier.expect(data)
        self._connection.receive(data)

    def _released(self, held: deque[bytes]) -> None:
        for data in held:
            self._connection.receive(data)

    def _hello(self, hello: Hello) -> dict[str, object]:
        if self._connection.session.principal is not _NOBODY:
            self._prove()
        return {}

    def drained(self) -> None:
        """Send what waits for room."""
        self.flush()

    def flush(self) -> None:
        """Send pending data while there is room in the windows."""
        pipe, outbox = self._pipe, self._connection.outbox
        if pipe.closed:
            return
        sent = self._send_stops()
        poor = self._allowance.left <= 0
        # The hub must know its session before anything else of it arrives.
        self._pause(paused=poor or not (pipe.greeted and pipe.writable(Priority.UPDATES)))
        if pipe.writable(Priority.CONTROL):
            sent += self._collect()
        if not poor:
            pipe.pump()
        if self._allowance.left <= 0:
            self._allowance.call(self.flush)
        outbox.park(pipe.parked)
        outbox.hand(pipe.buffered)
        if self._connection.expelled:
            self.close("the session has ended or moved to another link")
            return
        if sent and pipe.writable(Priority.CONTROL):
            outbox.again()  # else `drained` follows
        pipe.reading = not outbox.crowded
        pipe.acknowledge()

    def _collect(self) -> int:
        pipe, outbox, classifier = self._pipe, self._connection.outbox, self._classifier
        big = None if pipe.writable(Priority.BULK) else WHOLE
        budget = _BUDGET if self._paused else min(_BUDGET, max(1, self._allowance.left))
        messages = outbox.collect(int(budget), wrap=classifier.note, big=big)
        for data, priority in zip(messages, classifier.noted(), strict=True):
            pipe.send(data, priority)
        return len(messages)

    def _send_stops(self) -> int:
        """Send replies to e-stops ahead of all others, whatever the window."""
        if not self._classifier.expects:
            return 0
        outbox, rest, stops = self._connection.outbox, list[bytes](), 0
        for data in outbox.control:
            if self._classifier.is_stop(data):
                self._pipe.send(data, Priority.STOP)
                outbox.waiting -= len(data)
                stops += 1
            else:
                rest.append(data)
        if stops:
            outbox.control = rest
        return stops

    def _pause(self, *, paused: bool) -> None:
        if paused != self._paused:
            self._paused = paused
            outbox = self._connection.outbox
            if paused:
                outbox.pause()
            else:
                outbox.resume()

    def close(self, why: str) -> None:
        """End the link; its session waits for the hub to return."""
        self._pipe.end(why)

    def ended(self, why: str) -> None:
        """Release the connection."""
        level = log.info if self.known else log.debug  # anybody can begin and end many
        level("zenoh_link_ended", session=self._connection.session.id[:8], reason=why)
        self._statistics.ended(self._pipe, why)
        self._patience.cancel()
        self._connection.close()
        self._gone()

    def _note(self) -> None:
        self._statistics.note(self._pipe)
