"""Feeds that send alike bytes: one burst is queued and encoded once for all of them.

A hundred dashboards subscribe to one path: what differs between them is how far each has got,
and the head of their updates. So the samples stand in one ring, and a feed holds its place in it.
A receiver that falls behind the ring skips, is told how many, and delays nobody.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any

from rcp_kernel.errors import RcpError
from rcp_kernel.streams.outbox import BUDGET, FlushScheduler, Framing, Outbox, Wrap
from rcp_kernel.streams.path_subscription import SHARED, PathSubscription, Subscriber
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_kernel.values import Encoding

__all__ = [
    "SharedFanout",
    "SharedPathSubscription",
    "join_fanout",
    "leave_fanout",
    "path_subscriptions_of",
]


_JSON = Encoding.JSON
_KEPT = 16  # batches of frames kept for receivers that are alike
Fields = tuple[str, ...] | None
Batch = tuple[list[bytes], int, int]
"""Bytes for the socket, how many updates they hold, and how long they are."""


class _Tails:
    """The parts of some updates that all receivers of an encoding share."""

    __slots__ = ("count", "length", "longest", "parts")

    def __init__(self, samples: list[Sample], encoding: Encoding, fields: Fields) -> None:
        key = encoding if fields is None else (encoding, fields)
        found: list[bytes] = [b""]
        for sample in samples:
            try:
                found.append(sample.tails.get(key) or sample.tail(encoding, fields))
            except RcpError:  # reported as the backend's fault where it was found
                continue
        self.parts = found
        """An empty part, so that joining them by a beginning puts it before each; then the tails."""
        self.count = len(found) - 1
        lengths = set(map(len, found[1:]))
        self.length = lengths.pop() if len(lengths) == 1 else None
        """Of each tail, where all are alike."""
        self.longest = max(map(len, found))


class SharedFanout:
    """The samples that the feeds of one entry and depth have in common.

    A sample is taken in once for all of them. What follows is shared as far as it goes: the tails
    by all of an encoding, the frames by those whose updates have the same head.
    """

    __slots__ = (
        "_frames",
        "_made",
        "_sent_end",
        "_tails",
        "_ticker",
        "depth",
        "dirty",
        "end",
        "marked",
        "members",
        "ring",
    )

    def __init__(self, depth: int, ticker: FlushScheduler) -> None:
        self.depth = depth
        self._ticker = ticker
        self.members: list[SharedPathSubscription] = []
        self.ring: deque[Sample] = deque(maxlen=depth)
        self.end = 0
        """How many samples were offered ever."""
        self.dirty = False
        """Whether the coming tick will send the members what they have not got."""
        self.marked = False
        """Whether every member whose transport collects by itself waits for that."""
        self._sent_end = 0
        """What `end` was at the last tick."""
        self._made = 0
        """What `end` was when the following were made."""
        self._tails: dict[Any, _Tails] = {}
        self._frames: dict[Any, Batch] = {}

    def offer(self, sample: Sample) -> None:
        """Take a sample in; the first one of a loop turn has the coming tick send them."""
        self.ring.append(sample)
        self.end += 1
        if not self.dirty:
            self.dirty = True
            self._ticker.mark(self)
        if not self.marked:
            self.marked = True
            for member in self.members:
                outbox = member.outbox
                if not member.marked and outbox is not None and outbox.direct is None:
                    member.mark()

    def on_flush(self) -> None:
        """Send every member what it has not got, at once where nothing else waits for it."""
        start, self._sent_end = self._sent_end, self.end
        end, whole = self.end, self.end - start <= len(self.ring)
        share = framing = None
        parts: list[bytes] = []
        count = last = 0
        fits = False
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
                or outbox.held
            ):
                member.mark()
                continue
            if member.share is not share or outbox.framing is not framing or share is None:
                framing = outbox.framing
                assert framing is not None
                parts, count, size = self.batch(start, member, framing)
                share, last, fits = member.share, self.ring[-1].seq, size <= BUDGET
            if fits and direct(parts):
                member.place = end
                member.sent = last
                outbox.updates += count
            else:
                member.mark()

    def batch(self, start: int, feed: SharedPathSubscription, framing: Framing) -> Batch:
        """Return the bytes of all samples since `start`, their number and their length.

        What was made for a feed that had got as far serves its like too.
        """
        if self._made != self.end:
            self._made = self.end
            self._tails.clear()
            self._frames.clear()
        encoding, head = feed.head
        key = (start, feed.share, framing)
        found = self._frames.get(key)
        if found is None:
            found = self._make(start, encoding, head, feed.fields, framing)
            if len(self._frames) < _KEPT:
                self._frames[key] = found
        return found

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
        """Return the samples from the `start`th on, as far as the ring still has them."""
        wanted = self.end - start
        ring = list(self.ring)
        return ring[-wanted:] if wanted else []


class SharedPathSubscription(PathSubscription):
    """A feed without filters whose samples wait in a ring that it shares."""

    __slots__ = ("fanout", "place")

    def __init__(self, subscription: Subscriber, entry: Entry, outbox: Outbox | None) -> None:
        super().__init__(subscription, entry, outbox)
        self.fanout: SharedFanout | None = None
        self.place = 0
        """Number of the next sample of the fanout to send."""

    @property
    def waiting(self) -> int:
        """How many samples wait to be collected."""
        behind = 0 if self.fanout is None else min(self.fanout.end - self.place, self.depth)
        return super().waiting + behind

    def drain(self, out: list[bytes], budget: int, wrap: Wrap | None, big: int | None) -> int:
        """Move what waits to `out`: the common bytes where nothing is special about this feed."""
        fanout, outbox = self.fanout, self.outbox
        if outbox is None or fanout is None or self.place == fanout.end:
            return super().drain(out, budget, wrap, big)
        fanout.marked = False
        lost = fanout.end - self.place - len(fanout.ring)
        if lost > 0:
            self.place += lost
            self.dropped += lost
            self.subscription.skipped += lost
        framing = outbox.framing
        plain = framing is not None and wrap is None and big is None and self.named
        if framing is not None and plain and not (self.dropped or self.backlog or self.queue):
            parts, count, size = fanout.batch(self.place, self, framing)
            if size <= budget:
                self.place = fanout.end
                self.sent = fanout.ring[-1].seq
                outbox.updates += count
                out.extend(parts)
                return size
        self._take(fanout)
        return super().drain(out, budget, wrap, big)

    def _take(self, fanout: SharedFanout) -> None:
        """Go on alone with what waits, for as long as something is special."""
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
        """Let go of all that waits but the newest."""
        if self.fanout is not None and self.outbox is not None:
            self._take(self.fanout)
        super().conflate()

    def leave(self) -> None:
        """Forget what waits; the connection is gone."""
        super().leave()
        if self.fanout is not None:
            self.place = self.fanout.end


def join_fanout(feed: SharedPathSubscription, entry: Entry, scheduler: FlushScheduler) -> None:
    """Have a feed sing with its like among an entry's listeners, from the next sample on."""
    for listener in entry.listeners:
        if isinstance(listener, SharedFanout) and listener.depth == feed.depth:
            fanout = listener
            break
    else:
        fanout = SharedFanout(feed.depth, scheduler)
        entry.listeners.append(fanout)
    feed.fanout = fanout
    feed.place = fanout.end
    fanout.members.append(feed)
    fanout.marked = False


def leave_fanout(feed: SharedPathSubscription, entry: Entry) -> bool:
    """Take a feed out of its fanout; tell whether it was in one."""
    fanout = feed.fanout
    if fanout is None:
        return False
    feed.fanout = None
    fanout.members.remove(feed)
    if not fanout.members and fanout in entry.listeners:
        entry.listeners.remove(fanout)
    return True


def path_subscriptions_of(entry: Entry) -> Iterator[PathSubscription]:
    """Go through the feeds of an entry, whether they stand alone or in a fanout."""
    for listener in list(entry.listeners):
        if isinstance(listener, SharedFanout):
            yield from list(listener.members)
        elif isinstance(listener, PathSubscription):
            yield listener
