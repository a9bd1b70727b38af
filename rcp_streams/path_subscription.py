"""One path of one subscription (a `feed` in names): its queue, and the encoding of its updates.

The plain feed, used for most poses at 50 Hz, does a list access and a deque append per sample.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterable
from typing import Any, Protocol
from weakref import WeakValueDictionary

from rcp_conditions.filters import Where
from rcp_kernel.errors import RcpError
from rcp_kernel.sessions.outbox import FlushScheduler, Framing, Outbox, Wrap
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import NATIVE, Fields, Rendering, Sample
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_frame
from rcp_streams.options import Options
from rcp_streams.special_updates import first_native, shortened, spliced

__all__ = ["SHARED", "PathSubscription", "Subscriber"]

_JSON = Encoding.JSON  # Python 3.11 takes 0.1 µs to look it up in the enum
SHARED = 16_384  # bytes; longer updates are not copied into a shared frame


class _Share:
    """The shared part of feeds whose updates are the same bytes."""

    __slots__ = ("__weakref__",)


_shares: WeakValueDictionary[Any, _Share] = WeakValueDictionary()
"""By everything that determines the bytes; removed with the last of its feeds."""


class Subscriber(Protocol):
    """The part of a subscription that its paths use."""

    remaining: int | None
    skipped: int

    @property
    def id(self) -> str:
        """Its id in updates."""
        ...

    @property
    def options(self) -> Options:
        """The options of the client."""
        ...

    @property
    def where(self) -> Where | None:
        """The condition on its samples."""
        ...

    @property
    def outbox(self) -> Outbox | None:
        """The destination of its updates; None while the client is disconnected."""
        ...

    @property
    def feeds(self) -> dict[str, PathSubscription]:
        """Its paths."""
        ...

    def later(self, seconds: float, function: Callable[[], None]) -> None:
        """Call a function after a delay in seconds."""
        ...

    def longest(self, entry: Entry) -> int | None:
        """Return the longest value of an entry that is sent whole; None: no limit."""
        ...

    def delivered(self) -> bool:
        """Count one update; return whether it was the last of a limited number."""
        ...

    def overrun(self, feed: PathSubscription, why: str | None = None) -> None:
        """End the subscription, because a sample of a reliable path would have to be skipped."""
        ...


class PathSubscription:
    """One path of one subscription, without filters."""

    judges = False
    """Whether `admit` may drop or reduce a sample."""

    remote = False
    """Whether its values are not the samples of its entry, but come from the robot's own gateway."""

    __slots__ = (
        "_heads",
        "_lifespan",
        "_plain",
        "backlog",
        "depth",
        "dropped",
        "entry",
        "fields",
        "heard",
        "kept",
        "longest",
        "marked",
        "missed",
        "named",
        "native",
        "outbox",
        "paused",
        "priority",
        "queue",
        "reliable",
        "sent",
        "share",
        "subscription",
    )

    def __init__(self, subscription: Subscriber, entry: Entry, outbox: Outbox | None) -> None:
        options = subscription.options
        self.subscription = subscription
        self.entry = entry
        self.outbox = outbox
        self.queue: deque[Sample] = deque()
        self.backlog: deque[Sample] | None = None
        """Samples to replay before the queue; not subject to its depth."""
        self.depth = options.depth
        self.reliable = options.qos.reliability == "reliable"
        self.priority = options.qos.priority
        self.native = options.encoding == "native"
        self.named = not self.native
        """Whether the client was sent the name of the native type."""
        self.dropped = 0
        """Samples skipped since the last update that was sent; the next one tells the client."""
        self.sent = entry.seq
        """Number of the last sample that the client has or that preceded its subscription: only later
        ones can be missed."""
        self.heard = float("-inf")
        """Monotonic time of the last sample; only set with a deadline."""
        self.missed = False
        self.marked = False
        self.paused = False
        """The access rules do not allow it at the moment."""
        self.kept = False
        """The history of its path is kept for a disconnected client."""
        self.fields: Fields = NATIVE if self.native else options.fields
        if outbox is not None and outbox.renderings:
            self.fields = outbox.renderings.get(subscription.id, self.fields)
        self.longest = subscription.longest(entry)
        """Longest value sent whole, in bytes, to a client without segmented transfer;
        None: no limit."""
        self._lifespan = options.qos.lifespan
        self._plain = self._lifespan is None and options.count is None
        self._heads: tuple[Encoding, bytes, bytes] | None = None
        self.share: object = None
        """The key of the frame that all feeds with the same head share in a sample."""

    def listen(self, scheduler: FlushScheduler) -> None:
        """Add it to the listeners of its entry, which offer it all samples from now on."""
        self.entry.listeners.append(self)

    def unlisten(self) -> bool:
        """Remove it from the listeners of its entry; return whether it was among them."""
        entry = self.entry
        if self not in entry.listeners:
            return False
        # A new list, because a sample may just be being offered to the old one.
        entry.listeners = [listener for listener in entry.listeners if listener is not self]
        return True

    def follow(self) -> None:
        """Receive values with the current rights and backend; only for a `remote` one."""

    @property
    def waiting(self) -> int:
        """Number of queued samples."""
        return len(self.queue) + (len(self.backlog) if self.backlog else 0)

    def _old(self, sample: Sample) -> bool:
        """Return whether a sample has exceeded its lifespan in the queue."""
        lifespan = self._lifespan
        return lifespan is not None and self.entry.clock.now() - sample.received > lifespan * 1e9

    def offer(self, sample: Sample) -> None:
        """Queue a sample; a full queue drops its oldest one, or ends a reliable subscription."""
        queue = self.queue
        if len(queue) >= self.depth:
            if self.reliable:
                self.subscription.overrun(self)
                return
            queue.popleft()
            self.dropped += 1
            self.subscription.skipped += 1
        queue.append(sample)
        if not self.marked:
            self.mark()

    def conflate(self) -> None:
        """Drop all queued samples but the newest."""
        old = self.waiting - 1
        if old > 0:
            if self.backlog and not self.queue:
                self.queue.append(self.backlog[-1])
            self.backlog = None
            while len(self.queue) > 1:
                self.queue.popleft()
            self.dropped += old
            self.subscription.skipped += old

    def queued_bytes(self) -> int:
        """Estimate the number of queued bytes."""
        latest, waiting = self.entry.latest, self.waiting
        if latest is None or not waiting:
            return 0
        try:
            return waiting * (latest.encoded_size or latest.memory_size())
        except RcpError:
            return 0

    def shed(self, known: Container[str], reason: str) -> None:
        """Conflate, or end a reliable subscription whose id is `known`, with a reason."""
        if not self.reliable:
            self.conflate()
        elif self.waiting > 1 and self.subscription.id in known:
            self.subscription.overrun(self, reason)
            for other in self.subscription.feeds.values():
                other.conflate()

    def mark(self) -> None:
        """Mark this feed to be collected in the next tick."""
        outbox = self.outbox
        if outbox is not None:
            self.marked = True
            outbox.pending.append(self)
            if not outbox.dirty:
                outbox.mark()

    def replay(self, samples: Iterable[Sample]) -> None:
        """Queue earlier samples ahead of all others."""
        self.backlog = deque(samples)
        if self.backlog:
            self.sent = min(self.sent, self.backlog[0].seq - 1)
        if self.backlog and not self.marked:
            self.mark()

    def admit(self, sample: Sample) -> Sample | None:
        """Filter an earlier sample, for history and resume; None: it is dropped."""
        return sample

    def prime(self, sample: Sample) -> None:
        """Treat the current value as known, without sending it."""

    def drain(self, out: list[bytes], budget: int, wrap: Wrap | None, big: int | None) -> int:
        """Move queued samples to `out` as framed updates; return their number of bytes."""
        if self._plain and big is None and not self.backlog and self.named:
            return self._drain_plain(out, budget, wrap)
        size = 0
        remaining = self.subscription.remaining
        if remaining is not None and remaining <= 0:  # another path has used up the count
            self.queue.clear()
            self.backlog = None
            return 0
        while size < budget:
            queue = self.backlog or self.queue
            if not queue:
                break
            sample = queue[0]
            if self._old(sample):
                queue.popleft()
                self.dropped += 1
                self.subscription.skipped += 1
                continue
            try:
                data = self._frame(sample)
            except RcpError:  # reported as the backend's fault where it was found
                queue.popleft()
                continue
            if big is not None and len(data) > big:
                break
            queue.popleft()
            self.dropped = 0
            self.sent = sample.seq
            size += len(data)
            outbox = self.outbox
            assert outbox is not None
            if wrap is not None:
                data = wrap(data, sample)
            elif outbox.framing is not None:
                data = outbox.framing(len(data), data[:1] == b"{") + data
            out.append(data)
            outbox.updates += 1
            if self.subscription.remaining is not None and self.subscription.delivered():
                self.queue.clear()
                self.backlog = None
                break
        return size

    def _drain_plain(self, out: list[bytes], budget: int, wrap: Wrap | None) -> int:
        """Drain a feed without filters or limits: the hot loop of every fan-out."""
        outbox = self.outbox
        if outbox is None:  # ended after it was marked
            return 0
        encoding, head, _ = self._heads or self._make_heads()
        if outbox.framing is not None and wrap is None:
            return self._drain_framed(out, budget, outbox, outbox.framing)
        usual = encoding is _JSON and self.fields is None
        queue = self.queue
        size = 0
        while queue and size < budget:
            sample = queue.popleft()
            try:
                tail = (usual and sample.json_tail) or sample.tail(encoding, self.fields)
                special = self.dropped or len(tail) > SHARED
                data = self._frame(sample) if special else head + tail
            except RcpError:  # reported as the backend's fault where it was found
                continue
            self.dropped = 0
            self.sent = sample.seq
            size += len(data)
            out.append(data if wrap is None else wrap(data, sample))
            outbox.updates += 1
        return size

    def _drain_framed(self, out: list[bytes], budget: int, outbox: Outbox, framing: Framing) -> int:
        """Drain with frames built by the transport, once for all receivers of the same bytes."""
        share = self.share
        queue = self.queue
        size = count = 0
        while queue and size < budget:
            sample = queue.popleft()
            data = None if self.dropped else sample.encodings.get(share)
            if data is None:
                try:
                    data = self._make_frame(sample, out, framing)
                except RcpError:  # reported as the backend's fault where it was found
                    continue
            self.sent = sample.seq
            size += len(data)
            count += 1
            out.append(data)
        outbox.updates += count
        return size

    @property
    def head(self) -> tuple[Encoding, bytes]:
        """The encoding, and the start of every update without skipped samples."""
        encoding, head, _ = self._heads or self._make_heads()
        return encoding, head

    def _make_frame(self, sample: Sample, out: list[bytes], framing: Framing) -> bytes:
        """Return an update as a frame; the head of a long one is added to `out` first."""
        encoding, head, _ = self._heads or self._make_heads()
        text = encoding is Encoding.JSON
        if self.dropped:
            data = self._frame(sample)
            self.dropped = 0
            return framing(len(data), text) + data
        tail = sample.tail(encoding, self.fields)
        start = framing(len(head) + len(tail), text) + head
        if len(tail) > SHARED:
            if self._is_too_long(tail):
                data = shortened(self.subscription.id, sample, 0, self.fields, encoding)
                return framing(len(data), text) + data
            out.append(start)
            return tail
        data = sample.encodings[self.share] = start + tail
        return data

    def _frame(self, sample: Sample) -> bytes:
        encoding, head, head_dropped = self._heads or self._make_heads()
        tail = sample.tail(encoding, self.fields)
        if len(tail) > SHARED and self._is_too_long(tail):
            return shortened(self.subscription.id, sample, self.dropped, self.fields, encoding)
        if not self.named:
            data = first_native(
                self.subscription.id, sample, self.dropped, self.entry.resource.native, encoding
            )
            self.named = True
            return data
        if type(self.fields) is Rendering:
            self._tell_skipped()
            return head + tail
        if not self.dropped:
            return head + tail
        return (
            head_dropped
            + encode_frame({"dropped": self.dropped}, b"", encoding)[
                1 : -1 if encoding is Encoding.JSON else None
            ]
            + (b"," + tail if encoding is Encoding.JSON else tail)
        )

    def _is_too_long(self, tail: bytes) -> bool:
        """Return whether a value is too long for a subscription that matches it only by a pattern."""
        outbox = self.outbox
        limit = self.longest
        return limit is not None and len(tail) > limit and not (outbox and outbox.takes_long)

    def _tell_skipped(self) -> None:
        translator = None if self.outbox is None else self.outbox.translator
        if self.dropped and translator is not None:
            translator.skipped(self.subscription.id, self.entry.path, self.dropped)
            self.dropped = 0

    def _make_heads(self) -> tuple[Encoding, bytes, bytes]:
        assert self.outbox is not None
        encoding = self.subscription.options.splice or self.outbox.encoding
        if type(self.fields) is Rendering:
            head = self.fields.head
            self.share = _shares.setdefault((head, self.fields, self.outbox.framing), _Share())
            self._heads = encoding, head, head
            return self._heads
        facts = {"type": "update", "id": self.subscription.id, "path": self.entry.path}
        if self.native:
            facts["encoding"] = "native"
        head = encode_frame(facts, b"", encoding)
        self.share = _shares.setdefault((head, self.fields, self.outbox.framing), _Share())
        self._heads = encoding, *spliced(head, len(facts), encoding)
        return self._heads

    def leave(self) -> None:
        """Drop the queue; the connection is lost."""
        self.queue.clear()
        self.backlog = None
        self.marked = False
        self.outbox = None
        self._heads = None
        self.named = not self.native
