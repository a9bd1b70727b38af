"""The way out to one client: replies and notices in order, updates as fresh as the socket allows.

Nobody waits for a slow client. Updates wait in their feeds, bounded, and conflate; what goes into
the socket is collected once a loop turn, for all mailboxes in one shared tick, so that a burst
becomes one write.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import structlog

from rcp_kernel.values import Encoding

if TYPE_CHECKING:
    from rcp_kernel.streaming.feeds import Feed
    from rcp_kernel.streaming.samples import Sample

__all__ = ["BUDGET", "Framing", "Mailbox", "Ticker", "Wrap"]

log = structlog.get_logger("rcp.streams")
BUDGET = 262_144  # bytes that a mailbox gives away at once

Framing = Callable[[int, bool], bytes]
"""Make the head of a transport's frame, for a message of so many bytes, text or not."""

Wrap = Callable[[bytes, "Feed | None", "Sample | None"], bytes]
"""Frame one message for its transport: an update with its feed and sample, or a control message."""


class Dirty(Protocol):
    """What can be flushed by a tick."""

    dirty: bool
    """Whether a tick will; it sets this to False before it does."""

    @property
    def on_flush(self) -> Callable[[], None] | None:
        """Called by the tick."""
        ...


class Ticker:
    """One call per loop turn for all that have something to send."""

    __slots__ = ("_dirty", "_held", "_loop")

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._dirty: list[Dirty] = []
        self._held = False

    def mark(self, one: Dirty) -> None:
        """Flush a mailbox or chorus in the coming tick; it must not be marked already."""
        if not self._dirty and not self._held:
            self._loop.call_soon(self._tick)
        self._dirty.append(one)

    def gather(self, function: Callable[..., object], *args: Any) -> None:
        """Call a function, and tick at its end: what it has published goes out without a turn more."""
        if self._held or self._dirty:  # a tick will come that takes it along
            function(*args)
            return
        self._held = True
        try:
            function(*args)
        finally:
            self._held = False
            self._tick()

    def _tick(self) -> None:
        dirty, self._dirty = self._dirty, []
        for one in dirty:
            one.dirty = False
            flush = one.on_flush
            if flush is not None:
                try:
                    flush()
                except Exception:  # one client's trouble must not keep the others waiting
                    log.exception("flush_failed")


class Mailbox:
    """What one connection has to be sent; the transport collects it when its socket takes it."""

    __slots__ = (
        "_ticker",
        "alone",
        "control",
        "direct",
        "dirty",
        "encoding",
        "feedback",
        "framing",
        "high_water",
        "on_flush",
        "pending",
        "prioritised",
        "text",
        "updates",
    )

    def __init__(self, ticker: Ticker, encoding: Encoding, flush: Callable[[], None]) -> None:
        self._ticker = ticker
        self.on_flush: Callable[[], None] | None = flush
        """The transport's; None once it is gone."""
        self.encoding = encoding
        self.text = encoding is Encoding.JSON
        self.dirty = False
        self.framing: Framing | None = None
        """Set by a transport that sends whole messages in frames: `collect` then returns bytes
        ready for the socket, a long message in two parts, and like receivers share frames."""
        self.direct: Callable[[list[bytes]], bool] | None = None
        """Set by a transport that, with `framing`, sends frames at once while nothing else waits;
        False says that its socket does not take them now."""
        self.alone = False
        """Set by a transport that wraps each message in what is its client's own: there is nothing
        to share."""
        self.control: list[bytes] = []
        """Replies and notices: in order, never dropped."""
        self.feedback: dict[str, Callable[[], bytes]] = {}
        """The newest feedback of each running command, by command id."""
        self.pending: list[Feed] = []
        """Feeds with queued samples."""
        self.prioritised = False
        self.updates = 0
        self.high_water = 0

    def push(self, data: bytes) -> None:
        """Queue a control message."""
        self.control.append(data)
        self.mark()

    def mark(self) -> None:
        """Have the transport called in the coming tick."""
        if not self.dirty:
            self.dirty = True
            self._ticker.mark(self)

    def flush(self) -> None:
        """Call the transport, which collects if its socket can take more."""
        if self.on_flush is not None:
            self.on_flush()

    def close(self) -> None:
        """Forget everything; the transport is gone."""
        self.on_flush = self.direct = None
        self.control.clear()
        self.feedback.clear()
        self.pending.clear()

    @property
    def backlog(self) -> int:
        """How many messages wait."""
        return len(self.control) + len(self.feedback) + sum(feed.waiting for feed in self.pending)

    def collect(
        self,
        budget: int = BUDGET,
        *,
        wrap: Wrap | None = None,
        big: int | None = None,
    ) -> list[bytes]:
        """Take what is to be sent now: control first, then updates by priority.

        Stops after about `budget` bytes; what is left stays, and the transport collects again
        when the socket has room. With `big`, updates longer than that stay where they are, for a
        transport that is still busy with an earlier one.
        """
        out = self.control
        self.control = []
        if self.feedback:
            out.extend(make() for make in self.feedback.values())
            self.feedback.clear()
        if out and wrap is not None:
            out = [wrap(data, None, None) for data in out]
        elif out and self.framing is not None:
            text = self.text
            out = [self.framing(len(data), text) + data for data in out]
        pending = self.pending
        if not pending:
            return out
        later: list[Feed] = []
        self.pending = later
        if self.prioritised:
            pending.sort(key=_urgency)
        if len(pending) > self.high_water:  # noqa: PLR1730 - a call less for each update
            self.high_water = len(pending)
        for place, feed in enumerate(pending):
            budget -= feed.drain(out, budget, wrap, big)
            if feed.queue or feed.backlog:
                later.append(feed)
            else:
                feed.marked = False
            if budget <= 0:
                later.extend(pending[place + 1 :])
                break
        return out


def _urgency(feed: Feed) -> int:
    return -feed.priority


Queue = deque["Sample"]
