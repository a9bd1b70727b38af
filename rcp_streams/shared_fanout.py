"""Path subscriptions (feeds) that send the same bytes: a burst is encoded once for all of them.

If a hundred dashboards subscribe to one path, they differ only in their position and in the head
of their updates. So the samples are in one ring buffer, and each feed has a position in it. A
receiver that falls behind the ring skips samples, with their number, and delays nobody.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterator
from time import perf_counter
from typing import Any

from rcp_kernel.errors import RcpError
from rcp_kernel.sessions.outbox import BUDGET, TICK, FlushScheduler, Framing, Outbox, Wrap
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Fields, Rendering, Sample
from rcp_kernel.values import Encoding
from rcp_streams.path_subscription import SHARED, PathSubscription, Subscriber

__all__ = [
    "SharedFanout",
    "SharedPathSubscription",
    "path_subscriptions_of",
]


_JSON = Encoding.JSON
_KEPT = 16  # batches of frames kept for equal receivers
_GRACE = 0.001  # s after the interval in which a further sample saves the timer's wake-up
Batch = tuple[list[bytes], int, int]
"""Bytes for the socket, their number of updates, and their length."""


class _Tails:
    """The parts of updates that all receivers of an encoding share."""

    __slots__ = ("count", "length", "longest", "parts")

    def __init__(self, samples: list[Sample], encoding: Encoding, fields: Fields) -> None:
        parts: list[bytes] = [b""]
        for sample in samples:
            try:
                parts.append(sample.tail(encoding, fields))
            except RcpError:  # reported as the backend's fault where it was found
                continue
        self.parts = parts
        """An empty part, then the tails: joining them by a head puts it before each tail."""
        self.count = len(parts) - 1
        lengths = set(map(len, parts[1:]))
        self.length = lengths.pop() if len(lengths) == 1 else None
        """Length of each tail, if all are equal."""
        self.longest = max(map(len, parts))


class SharedFanout:
    """The samples shared by the feeds of one entry, depth and interval of writes.

    A sample is queued once for all of them. Tails are shared by all feeds of an encoding, frames
    by those whose updates have the same head. With an interval, samples that come sooner after a
    write wait for each other: most of what a fast path costs are the writes to sockets.
    """

    __slots__ = (
        "_flush_scheduler",
        "_frames",
        "_made",
        "_patience",
        "_sent_at",
        "_sent_end",
        "_tails",
        "_timer",
        "depth",
        "dirty",
        "end",
        "marked",
        "members",
        "ring",
        "write_interval",
    )

    def __init__(self, depth: int, write_interval: float, ticker: FlushScheduler) -> None:
        self.depth = depth
        self.write_interval = write_interval
        """Seconds between two writes; 0: samples are sent as they come."""
        self._flush_scheduler = ticker
        self._patience = depth // 2
        """Number of samples that wait for each other: less than would be skipped."""
        self._sent_at = float("-inf")
        self._timer: asyncio.TimerHandle | None = None
        self.members: list[SharedPathSubscription] = []
        self.ring: deque[Sample] = deque(maxlen=depth)
        self.end = 0
        """Number of samples offered so far."""
        self.dirty = False
        """Whether the next tick will send pending samples to the members."""
        self.marked = False
        """Whether all members whose transport collects by itself are marked for it."""
        self._sent_end = 0
        """Value of `end` at the last tick."""
        self._made = 0
        """Value of `end` for which the following were built."""
        self._tails: dict[Any, _Tails] = {}
        self._frames: dict[Any, Batch] = {}

    def offer(self, sample: Sample) -> None:
        """Queue a sample; the first one of a loop iteration schedules the tick, if none is to wait."""
        self.ring.append(sample)
        self.end += 1
        if not self.dirty and not (self.write_interval and self._waits()):
            self.dirty = True
            self._flush_scheduler.mark(self)
        if not self.marked:
            self.marked = True
            for member in self.members:
                outbox = member.outbox
                if not member.marked and outbox is not None and outbox.direct is None:
                    member.mark()

    def _waits(self) -> bool:
        """Return whether the samples since the last write wait for others, or for the timer."""
        wait = self.write_interval - (perf_counter() - self._sent_at)
        if wait <= 0 or self.end - self._sent_end > self._patience:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None
            return False
        if self._timer is None:
            self._timer = self._flush_scheduler.later(wait + _GRACE, self._waited)
        return True

    def _waited(self) -> None:
        self._timer = None
        if not self.dirty:
            self.dirty = True
            self._flush_scheduler.mark(self)

    def on_flush(self) -> None:
        """Send pending samples to every member, directly if nothing else is queued for it.

        Long ones are sent directly for the time of a tick; the next one goes on with the rest.
        """
        if self.write_interval:
            self._sent_at = perf_counter()
        start, self._sent_end = self._sent_end, self.end
        end, whole = self.end, self.end - start <= len(self.ring)
        share = framing = None
        parts: list[bytes] = []
        count = last = 0
        fits = False
        until = 0.0
        for member in list(self.members):
            outbox = member.outbox
            if outbox is None or member.marked or member.place == end:
                continue
            direct = outbox.direct
            if (
                direct is None
                or not whole
                or member.place != start
                or member.dropped
                or not member.named
                or outbox.prioritised
                or outbox.control
                or outbox.pending
                or outbox.dirty
                or outbox.feedback
                or outbox.paused
            ):
                member.mark()
                continue
            if member.share is not share or outbox.framing is not framing or share is None:
                framing = outbox.framing
                assert framing is not None
                parts, count, size = self.batch(start, member, framing)
                share, last, fits = member.share, self.ring[-1].seq, size <= BUDGET
                if not (fits or until):
                    until = perf_counter() + TICK
            takes = fits or (count == 1 and until > perf_counter() and _takes_long(member, outbox))
            if takes and (unread := direct(parts)) is not None:
                member.place = end
                member.sent = last
                outbox.updates += count
                if unread:
                    outbox.hand(unread)
            else:
                member.mark()

    def batch(self, start: int, feed: SharedPathSubscription, framing: Framing) -> Batch:
        """Return the bytes of all samples since `start`, with their number and length.

        They are reused for equal feeds at the same position.
        """
        if self._made != self.end:
            self._made = self.end
            self._tails.clear()
            self._frames.clear()
        encoding, head = feed.head
        key = (start, feed.share, framing)
        batch = self._frames.get(key)
        if batch is None:
            batch = self._make(start, encoding, head, feed.fields, framing)
            if len(self._frames) < _KEPT:
                self._frames[key] = batch
        return batch

    def _make(
        self, start: int, encoding: Encoding, head: bytes, fields: Fields, framing: Framing
    ) -> Batch:
        tails = self._tails.get((start, encoding, fields))
        if tails is None:
            tails = _Tails(self.since(start), encoding, fields)
            self._tails[start, encoding, fields] = tails
        text = encoding is _JSON
        if tails.length is not None and tails.longest <= SHARED:
            frames = (framing(len(head) + tails.length, text) + head).join(tails.parts)
            return [frames], tails.count, len(frames)
        parts: list[bytes] = []
        for tail in tails.parts[1:]:
            parts += framing(len(head) + len(tail), text), head, tail
        if tails.longest <= SHARED:
            parts = [b"".join(parts)]
        return parts, tails.count, sum(map(len, parts))

    def since(self, start: int) -> list[Sample]:
        """Return the samples from number `start` on, as far as the ring still has them."""
        count = self.end - start
        ring = list(self.ring)
        return ring[-count:] if count else []


class SharedPathSubscription(PathSubscription):
    """A feed without filters whose samples are in a shared ring buffer."""

    __slots__ = ("fanout", "place", "write_interval")

    def __init__(self, subscription: Subscriber, entry: Entry, outbox: Outbox | None) -> None:
        super().__init__(subscription, entry, outbox)
        fields = self.fields
        self.write_interval = fields.write_interval if isinstance(fields, Rendering) else 0.0
        self.fanout: SharedFanout | None = None
        self.place = 0
        """Number of the fan-out's next sample to send."""

    def listen(self, scheduler: FlushScheduler) -> None:
        """Join the fan-out of equal feeds of its entry, from the next sample on."""
        listeners = self.entry.listeners
        for listener in listeners:
            if (
                isinstance(listener, SharedFanout)
                and listener.depth == self.depth
                and listener.write_interval == self.write_interval
            ):
                fanout = listener
                break
        else:
            fanout = SharedFanout(self.depth, self.write_interval, scheduler)
            listeners.append(fanout)
        self.fanout = fanout
        self.place = fanout.end
        fanout.members.append(self)
        fanout.marked = False

    def unlisten(self) -> bool:
        """Leave its fan-out; return whether it was in one."""
        fanout, listeners = self.fanout, self.entry.listeners
        if fanout is None:
            return False
        self.fanout = None
        fanout.members.remove(self)
        if not fanout.members and fanout in listeners:
            listeners.remove(fanout)
        return True

    @property
    def waiting(self) -> int:
        """Number of queued samples."""
        behind = 0 if self.fanout is None else min(self.fanout.end - self.place, self.depth)
        return super().waiting + behind

    def drain(self, out: list[bytes], budget: int, wrap: Wrap | None, big: int | None) -> int:
        """Move queued samples to `out`, as shared bytes unless this feed needs different ones."""
        fanout, outbox = self.fanout, self.outbox
        if outbox is None or fanout is None or self.place == fanout.end:
            return super().drain(out, budget, wrap, big)
        fanout.marked = False
        skipped = fanout.end - self.place - len(fanout.ring)
        if skipped > 0:
            self.place += skipped
            self.dropped += skipped
            self.subscription.skipped += skipped
        framing = outbox.framing
        plain = framing is not None and wrap is None and big is None and self.named
        if framing is not None and plain and not (self.dropped or self.backlog or self.queue):
            parts, count, size = fanout.batch(self.place, self, framing)
            if size <= budget or (count == 1 and self.longest is None):
                self.place = fanout.end
                self.sent = fanout.ring[-1].seq
                outbox.updates += count
                out.extend(parts)
                return size
        self._take(fanout)
        return super().drain(out, budget, wrap, big)

    def _take(self, fanout: SharedFanout) -> None:
        """Queue the pending samples individually while this feed needs different bytes."""
        if fanout.end - self.place == 1:
            self.queue.append(fanout.ring[-1])
        else:
            self.queue.extend(fanout.since(self.place))
        self.place = fanout.end
        while len(self.queue) > self.depth:
            self.queue.popleft()
            self.dropped += 1
            self.subscription.skipped += 1

    def conflate(self) -> None:
        """Drop all queued samples but the newest."""
        if self.fanout is not None and self.outbox is not None:
            self._take(self.fanout)
        super().conflate()

    def leave(self) -> None:
        """Drop the queue; the connection is lost."""
        super().leave()
        if self.fanout is not None:
            self.place = self.fanout.end


def _takes_long(feed: SharedPathSubscription, outbox: Outbox) -> bool:
    """Return whether a sample above the budget may be sent at once, and whole."""
    return feed.longest is None and not outbox.backlog.full


def path_subscriptions_of(entry: Entry) -> Iterator[PathSubscription]:
    """Iterate over the feeds of an entry, in fan-outs or not."""
    for listener in [*entry.listeners, *entry.framed]:
        if isinstance(listener, SharedFanout):
            yield from list(listener.members)
        elif isinstance(listener, PathSubscription):
            yield listener
