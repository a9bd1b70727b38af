"""Feeds that send the same bytes: one burst is queued, encoded and framed once for all of them.

A hundred dashboards that run one page subscribe to one path with one id: what differs between
them is only how far each has got. So the samples stand in one ring, and a feed holds its place in
it. A receiver that falls behind the ring skips, is told how many, and delays nobody.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from rcp_kernel.errors import RcpError
from rcp_kernel.streams import Feed

if TYPE_CHECKING:
    from rcp_kernel.mailbox import Framing, Mailbox, Wrap
    from rcp_kernel.registry import Entry
    from rcp_kernel.samples import Sample
    from rcp_kernel.streams import Subscription

__all__ = ["Chorus", "ChorusFeed", "feeds_of", "join", "part"]


class Chorus:
    """The samples that some feeds of one entry have in common."""

    __slots__ = ("_batch", "_key", "end", "key", "marked", "members", "ring")

    def __init__(self, key: Any, depth: int) -> None:
        self.key = key
        self.members: list[ChorusFeed] = []
        self.ring: deque[Sample] = deque(maxlen=depth)
        self.end = 0
        """How many samples were offered ever."""
        self.marked = False
        """Whether every member is waiting to be collected."""
        self._key: Any = None
        self._batch: tuple[list[bytes], int, int] = ([], 0, 0)

    def offer(self, sample: Sample) -> None:
        """Take a sample in; the first one of a loop turn has every member collected."""
        self.ring.append(sample)
        self.end += 1
        if not self.marked:
            self.marked = True
            for member in self.members:
                if not member.marked:
                    member.mark()

    def batch(self, start: int, feed: ChorusFeed, framing: Framing) -> tuple[list[bytes], int, int]:
        """Return the bytes of all samples since `start`, their number and their length.

        What was made for the last feed that had got as far serves this one too.
        """
        key = (start, self.end, framing)
        if key != self._key:
            self._batch = self._make(start, feed, framing)
            self._key = key
        return self._batch

    def _make(self, start: int, feed: ChorusFeed, framing: Framing) -> tuple[list[bytes], int, int]:
        frames: list[bytes] = []
        count = 0
        for sample in self.since(start):
            try:
                frames.append(feed.make_frame(sample, frames, framing))
            except RcpError:  # reported as the backend's fault where it was found
                continue
            count += 1
        size = sum(map(len, frames))
        return ([b"".join(frames)] if len(frames) == count else frames), count, size

    def since(self, start: int) -> list[Sample]:
        """Return the samples from the `start`th on, as far as the ring still has them."""
        wanted = self.end - start
        ring = list(self.ring)
        return ring[-wanted:] if wanted else []


class ChorusFeed(Feed):
    """A feed without filters whose samples wait in a ring that it shares."""

    __slots__ = ("chorus", "place")

    def __init__(self, subscription: Subscription, entry: Entry, mailbox: Mailbox | None) -> None:
        super().__init__(subscription, entry, mailbox)
        self.chorus: Chorus | None = None
        self.place = 0
        """Number of the next sample of the chorus to send."""

    @property
    def key(self) -> Any:
        """What feeds must have in common to send the same bytes."""
        mailbox = self.mailbox
        assert mailbox is not None
        encoding = self.subscription.options.splice or mailbox.encoding
        return (self.subscription.id, encoding, self.fields, self.depth)

    @property
    def waiting(self) -> int:
        """How many samples wait to be collected."""
        behind = 0 if self.chorus is None else min(self.chorus.end - self.place, self.depth)
        return super().waiting + behind

    def drain(self, out: list[bytes], budget: int, wrap: Wrap | None, big: int | None) -> int:
        """Move what waits to `out`: the common bytes where nothing is special about this feed."""
        chorus, mailbox = self.chorus, self.mailbox
        if mailbox is None or chorus is None or self.place == chorus.end:
            return super().drain(out, budget, wrap, big)
        chorus.marked = False
        lost = chorus.end - self.place - len(chorus.ring)
        if lost > 0:
            self.place += lost
            self.dropped += lost
            self.skipped += lost
        framing = mailbox.framing
        plain = framing is not None and wrap is None and big is None
        if framing is not None and plain and not (self.dropped or self.backlog or self.queue):
            parts, count, size = chorus.batch(self.place, self, framing)
            if size <= budget:
                self.place = chorus.end
                self.sent = chorus.ring[-1].seq
                mailbox.updates += count
                out.extend(parts)
                return size
        self._take(chorus)
        return super().drain(out, budget, wrap, big)

    def _take(self, chorus: Chorus) -> None:
        """Go on alone with what waits, for as long as something is special."""
        if chorus.end - self.place == 1:
            self.queue.append(chorus.ring[-1])
        else:
            self.queue.extend(chorus.since(self.place))
        self.place = chorus.end
        while len(self.queue) > self.depth:
            self.queue.popleft()
            self.dropped += 1
            self.skipped += 1

    def leave(self) -> None:
        """Forget what waits; the connection is gone."""
        super().leave()
        if self.chorus is not None:
            self.place = self.chorus.end


def join(feed: ChorusFeed, entry: Entry) -> None:
    """Have a feed sing with its like among an entry's listeners, from the next sample on."""
    key = feed.key
    for listener in entry.listeners:
        if isinstance(listener, Chorus) and listener.key == key:
            chorus = listener
            break
    else:
        chorus = Chorus(key, feed.depth)
        entry.listeners.append(chorus)
    feed.chorus = chorus
    feed.place = chorus.end
    chorus.members.append(feed)
    chorus.marked = False


def part(feed: ChorusFeed, entry: Entry) -> bool:
    """Take a feed out of its chorus; tell whether it was in one."""
    chorus = feed.chorus
    if chorus is None:
        return False
    feed.chorus = None
    chorus.members.remove(feed)
    if not chorus.members and chorus in entry.listeners:
        entry.listeners.remove(chorus)
    return True


def feeds_of(entry: Entry) -> Iterator[Feed]:
    """Go through the feeds of an entry, whether they stand alone or in a chorus."""
    for listener in list(entry.listeners):
        if isinstance(listener, Chorus):
            yield from list(listener.members)
        elif isinstance(listener, Feed):
            yield listener
