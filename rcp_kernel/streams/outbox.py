"""The way out to one client: replies and notices in order, updates as fresh as the socket allows.

Nobody waits for a slow client. Updates wait in their feeds, bounded, and conflate; replies are
counted in bytes, and a client that leaves too many unread is asked for nothing more. What goes into
the socket is collected once a loop turn, for all outboxes in one shared tick, so that a burst
becomes one write.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Container
from time import perf_counter
from typing import Any, Protocol

import structlog

from rcp_kernel.streams.outbound import SHARE, Backlog
from rcp_kernel.tree.samples import Sample
from rcp_kernel.values import Encoding

__all__ = ["BUDGET", "FlushScheduler", "Framing", "Outbox", "PendingPath", "Wrap"]

log = structlog.get_logger("rcp.streams")
BUDGET = 262_144  # bytes that an outbox gives away at once
_PATIENCE = 0.001  # s that it collects samples of many paths, before others have their turn
_TICK = 0.004  # s of one tick: outboxes that are left wait for the next turn of the loop
_FEW = 32  # paths that are collected between looks at the time

Framing = Callable[[int, bool], bytes]
"""Make the head of a transport's frame, for a message of so many bytes, text or not."""

Wrap = Callable[[bytes, Sample | None], bytes]
"""Frame one message for its transport: an update with its sample, or a control message."""


class PendingPath(Protocol):
    """A path of a subscription, with updates that wait to be collected."""

    marked: bool
    queue: deque[Sample]
    backlog: deque[Sample] | None

    @property
    def priority(self) -> int:
        """The higher, the sooner it is collected."""
        ...

    @property
    def depth(self) -> int:
        """How many samples may wait."""
        ...

    @property
    def waiting(self) -> int:
        """How many samples wait."""
        ...

    def drain(self, out: list[bytes], budget: int, wrap: Wrap | None, big: int | None) -> int:
        """Move queued samples to `out` as framed updates; return how many bytes that were."""
        ...

    def weight(self) -> int:
        """Estimate how many bytes wait."""
        ...

    def shed(self, known: Container[str], reason: str) -> None:
        """Conflate, or end a reliable subscription whose id is `known`, for a reason."""
        ...


class Flushable(Protocol):
    """What can be flushed by a tick."""

    dirty: bool
    """Whether a tick will; it sets this to False before it does."""

    @property
    def on_flush(self) -> Callable[[], None] | None:
        """Called by the tick."""
        ...


class FlushScheduler:
    """One call per loop turn for all that have something to send."""

    __slots__ = ("_dirty", "_held", "_loop")

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._dirty: list[Flushable] = []
        self._held = False

    def mark(self, one: Flushable) -> None:
        """Flush an outbox or fanout in the coming tick; it must not be marked already."""
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
        until = perf_counter() + _TICK
        for place, one in enumerate(dirty):
            if place and perf_counter() > until:
                self._postpone(dirty[place:])
                return
            one.dirty = False
            flush = one.on_flush
            if flush is not None:
                try:
                    flush()
                except Exception:  # one client's trouble must not keep the others waiting
                    log.exception("flush_failed")

    def _postpone(self, left: list[Flushable]) -> None:
        """Go on in the coming turn of the loop, ahead of what was marked meanwhile."""
        if not self._dirty:
            self._loop.call_soon(self._tick)
        self._dirty[:0] = left


class Outbox:
    """What one connection has to be sent; the transport collects it when its socket takes it."""

    __slots__ = (
        "_ticker",
        "alone",
        "backlog",
        "buffered",
        "control",
        "direct",
        "dirty",
        "encoding",
        "feedback",
        "framing",
        "held",
        "high_water",
        "on_flush",
        "parked",
        "pending",
        "prioritised",
        "takes_long",
        "text",
        "updates",
        "waiting",
    )

    def __init__(
        self,
        ticker: FlushScheduler,
        encoding: Encoding,
        flush: Callable[[], None],
        backlog: Backlog,
    ) -> None:
        self._ticker = ticker
        self.backlog = backlog
        """What is counted of all that waits for this client."""
        self.on_flush: Callable[[], None] | None = flush
        """The transport's; None once it is gone."""
        self.encoding = encoding
        self.text = encoding is Encoding.JSON
        self.dirty = False
        self.framing: Framing | None = None
        """Frames for the transport, see `send_frames`."""
        self.direct: Callable[[list[bytes]], bool] | None = None
        self.alone = False
        """Each message is wrapped in what is its client's own: there is nothing to share."""
        self.takes_long = False
        """The client takes messages of any length, as it agreed to get them in parts: values that
        only a pattern asks for come whole too."""
        self.control: list[bytes] = []
        """Replies and notices: in order, never dropped. Queue them by `put`, which counts them."""
        self.waiting = 0
        """Bytes of `control`."""
        self.parked = 0
        """Bytes of messages that the transport has collected and sends in parts."""
        self.buffered = 0
        """Bytes that the transport has given away and the client has not taken."""
        self.feedback: dict[str, Callable[[], bytes]] = {}
        """The newest feedback of each running command, by command id."""
        self.pending: list[PendingPath] = []
        """Feeds with queued samples."""
        self.held = 0
        """How many subscriptions are looked through for what the client may not see any more: no
        update is collected meanwhile. Count by `hold` and `release`."""
        self.prioritised = False
        self.updates = 0
        self.high_water = 0

    def put(self, data: bytes) -> None:
        """Queue a control message."""
        self.control.append(data)
        self.waiting += len(data)
        if self.waiting > SHARE:
            self.weigh()
        if not self.dirty:
            self.mark()

    def put_first(self, data: bytes) -> None:
        """Queue a control message ahead of all others."""
        self.control.insert(0, data)
        self.waiting += len(data)
        self.mark()

    def send_frames(self, framing: Framing, direct: Callable[[list[bytes]], bool]) -> None:
        """Collect frames, for a transport that sends whole messages in such.

        `collect` then returns bytes ready for the socket, a long message in two parts, and like
        receivers share frames. While nothing else waits, `direct` sends frames at once; False says
        that the socket does not take them now.
        """
        self.framing, self.direct, self.takes_long = framing, direct, False

    def send_messages(self, *, long: bool = False) -> None:
        """Collect whole messages without frames, as at the beginning.

        `long` tells that the client takes those of any length, as it gets them in parts.
        """
        self.framing = self.direct = None
        self.takes_long = long

    def gather(self) -> None:
        """Mark nothing for the coming tick: the transport calls `settle` at the end of a read."""
        self.dirty = True

    def settle(self, *, alone: bool) -> bytes | None:
        """End what `gather` began; take the one message that waits, if it may go `alone`."""
        self.dirty = False
        if alone and len(self.control) == 1 and not (self.pending or self.feedback):
            self.waiting = 0
            return self.control.pop()
        return None

    def hand(self, buffered: int) -> None:
        """Take notice of how many bytes the transport has given away that were not taken."""
        if buffered != self.buffered:
            self.buffered = buffered
            self.weigh()

    def park(self, size: int) -> None:
        """Take notice of how many bytes the transport sends in parts, or keeps to send again."""
        if size != self.parked:
            self.parked = size
            self.weigh()

    def weigh(self) -> None:
        """Count all that waits."""
        self.backlog.set(self.waiting + self.parked + self.buffered)

    @property
    def crowded(self) -> bool:
        """Whether nothing more should be read from the client, as it leaves so much unread."""
        return self.backlog.size > SHARE and self.backlog.crowded

    @property
    def more(self) -> bool:
        """Whether something waits to be collected."""
        return bool(self.control or self.feedback or (self.pending and not self.held))

    def hold(self) -> None:
        """Collect no updates until they are released; they wait, and conflate."""
        self.held += 1

    def release(self) -> None:
        """Collect updates again, once nobody holds them."""
        self.held -= 1
        if not self.held and self.pending:
            self.mark()

    def again(self) -> None:
        """Have the transport called once more for what is left, as soon as there is room for it."""
        if not (self.control or self.feedback) and self.pending and self.backlog.full:
            self.backlog.wait(self)
        elif self.more:
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
        self.waiting = self.parked = self.buffered = 0
        self.backlog.close(self)

    @property
    def depth(self) -> int:
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
        when the socket has room (`more`). With `big`, updates longer than that stay where they
        are, for a transport that is still busy with an earlier one.
        """
        long = self.waiting > SHARE
        if self.waiting <= budget:
            out = self.control
            self.control = []
            self.waiting = 0
        else:
            out = self._take(budget)
        if self.feedback and not self.control:
            self._take_feedback(out, budget)
        if self.backlog.size:
            self.weigh()
        if out and wrap is not None:
            out = [wrap(data, None) for data in out]
        elif out and self.framing is not None:
            text = self.text
            frame = self.framing
            if long:  # a head goes before what is long, so that nothing copies that
                out = [part for data in out for part in (frame(len(data), text), data)]
            else:
                out = [frame(len(data), text) + data for data in out]
        pending = self.pending
        if not pending or self.control or self.feedback or self.held:
            return out
        if big is None and self.backlog.full:
            big = SHARE  # long updates wait, and conflate, until others have taken theirs
        later: list[PendingPath] = []
        self.pending = later
        if self.prioritised:
            pending.sort(key=_urgency)
        if len(pending) > self.high_water:  # noqa: PLR1730 - a call less for each update
            self.high_water = len(pending)
        until = perf_counter() + _PATIENCE if len(pending) > _FEW else 0.0
        for place, feed in enumerate(pending, 1):
            budget -= feed.drain(out, budget, wrap, big)
            if feed.queue or feed.backlog:
                later.append(feed)
            else:
                feed.marked = False
            if budget <= 0 or (not place % _FEW and perf_counter() > until):
                later.extend(pending[place:])
                break
        return out

    def _take(self, budget: int) -> list[bytes]:
        """Take the first control messages, one at least, up to about `budget` bytes."""
        size = count = 0
        for data in self.control:
            size += len(data)
            count += 1
            if size >= budget:
                break
        out = self.control[:count]
        del self.control[:count]
        self.waiting -= size
        return out

    def _take_feedback(self, out: list[bytes], budget: int) -> None:
        while self.feedback and budget > 0:
            data = self.feedback.pop(next(iter(self.feedback)))()
            budget -= len(data)
            out.append(data)


def _urgency(feed: PendingPath) -> int:
    return -feed.priority


Queue = deque["Sample"]
