"""Feeds that filter or replace samples: filters, hidden parts and views."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Hashable, Iterable
from typing import Any, NamedTuple, Protocol

from rcp_conditions.filters import Change
from rcp_kernel.contract.internal_errors import to_internal_error
from rcp_kernel.errors import RcpError, UnsupportedOperation
from rcp_kernel.sessions.outbox import Outbox, Wrap
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Rendering, Sample, masked, project
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Body, encode_body, encode_frame
from rcp_streams.path_subscription import PathSubscription, Subscriber
from rcp_streams.shared_update import SharedUpdate

__all__ = [
    "FilteredPathSubscription",
    "View",
    "ViewSubscription",
    "VisibilityFilteredSubscription",
]

_LONGEST = 86_400.0  # s, maximum period between updates


class FilteredPathSubscription(PathSubscription):
    """One path of a subscription with filters."""

    judges = True

    __slots__ = ("_armed", "_change", "_due", "_interval", "_monotonic", "_waiting", "_where")

    def __init__(self, subscription: Subscriber, entry: Entry, outbox: Outbox | None) -> None:
        super().__init__(subscription, entry, outbox)
        options = subscription.options
        self._where = subscription.where.fresh() if subscription.where else None
        wants_change = options.on == "change" or options.deadband is not None
        self._change = Change(options.deadband, options.fields) if wants_change else None
        self._interval = min(1.0 / options.rate, _LONGEST) if options.rate else 0.0
        self._monotonic = entry.clock.monotonic
        self._due = float("-inf")
        self._waiting: Sample | None = None
        self._armed = False
        """Whether a timer is set for the waiting sample."""

    def offer(self, sample: Sample) -> None:
        """Queue a sample that passes every filter; hold it back while the rate requires this."""
        if self._where is not None and not self._passes(sample):
            return
        if self._interval:
            wait = self._due - self._monotonic()
            # A tenth of the period is tolerated, because a source at the requested rate has jitter.
            if wait > self._interval * 0.1:
                self._waiting = sample
                self._arm(wait)
                return
            self._waiting = None
        self._emit(sample)

    def _arm(self, wait: float) -> None:
        if not self._armed:
            self._armed = True
            self.subscription.later(wait, self._release)

    def _release(self) -> None:
        self._armed = False
        if self._waiting is None or self.outbox is None:
            return
        # A sample may have been sent early by the tolerance: the waiting one waits for its own period.
        wait = self._due - self._monotonic()
        if wait > self._interval * 0.1:
            self._arm(wait)
            return
        sample, self._waiting = self._waiting, None
        self._emit(sample)

    def _emit(self, sample: Sample) -> None:
        if self._change is not None:
            try:
                if not self._change.passes(sample.value):
                    return
            except RcpError:
                return
        if self._interval:
            moment = self._monotonic()
            late = moment - self._due
            # Keep the phase of the period where possible, so that the mean rate is the requested one.
            self._due = (self._due if late < self._interval else moment) + self._interval
        super().offer(sample)

    def _passes(self, sample: Sample) -> bool:
        assert self._where is not None
        try:
            return self._where.passes(sample.value)
        except RcpError:
            return False

    def replay(self, samples: Iterable[Sample]) -> None:
        """Queue earlier samples; the next new one keeps the period from them."""
        super().replay(samples)
        if self.backlog and self._interval:
            self._due = self._monotonic() + self._interval

    def admit(self, sample: Sample) -> Sample | None:
        """Return an earlier sample if it passes; the rate does not apply to earlier samples."""
        if self._where is not None and not self._passes(sample):
            return None
        if self._change is None:
            return sample
        try:
            return sample if self._change.passes(sample.value) else None
        except RcpError:
            return None

    def prime(self, sample: Sample) -> None:
        """Pass the current value to the filters, without sending it."""
        self.admit(sample)

    def leave(self) -> None:
        """Drop queued and waiting samples."""
        super().leave()
        self._waiting = None


class VisibilityFilteredSubscription(FilteredPathSubscription):
    """A path of which each principal may see only some samples, or parts of them."""

    __slots__ = ("_shown",)

    def __init__(
        self,
        subscription: Subscriber,
        entry: Entry,
        outbox: Outbox | None,
        shown: Callable[[Any], Any],
    ) -> None:
        super().__init__(subscription, entry, outbox)
        self._shown = shown

    def offer(self, sample: Sample) -> None:
        """Queue the part of a sample that this principal may see."""
        # Before the filters, so that their results reveal nothing hidden.
        if (admitted := self._filtered(sample)) is not None:
            super().offer(admitted)

    def admit(self, sample: Sample) -> Sample | None:
        """Return the visible part of an earlier sample, if it passes the filters."""
        admitted = self._filtered(sample)
        return None if admitted is None else super().admit(admitted)

    def _filtered(self, sample: Sample) -> Sample | None:
        return masked(sample, self._shown)


class View(Protocol):
    """The value of a path for one reader, computed for each."""

    @property
    def sees(self) -> Hashable:
        """The reader's properties that determine the value: it is not sent once they have changed."""
        ...

    def shared(self, seq: int) -> SharedUpdate | None:
        """Return what readers share of an update with this number; None if they share nothing."""
        ...

    def make(self, encoding: Encoding) -> Generator[None, None, Any]:
        """Compute the value; lists in steps, limited to one page."""
        ...

    def begin(self, work: Generator[None]) -> None:
        """Start work that runs in steps when the loop has time."""
        ...


class _Made(NamedTuple):
    """A value computed for a reader."""

    sees: Hashable
    data: bytes
    truncated: bool


class ViewSubscription(PathSubscription):
    """A path whose value depends on the reader: a sample only signals a change.

    Lists may be long and their subscribers many: each value is computed in separate steps before
    the samples that wait for it are queued.
    """

    __slots__ = ("_fresh", "_made", "_making", "_past", "_shared", "_view", "_works")

    def __init__(
        self, subscription: Subscriber, entry: Entry, outbox: Outbox | None, view: View
    ) -> None:
        super().__init__(subscription, entry, outbox)
        self._plain = False
        self._view = view
        self._fresh: deque[Sample] = deque()
        """Samples waiting for a value."""
        self._making: deque[Sample] = deque()
        """Samples for which the value is being computed."""
        self._past: deque[Sample] = deque()
        """Earlier samples to replay with the value."""
        self._made: _Made | None = None
        """The newest value; all queued samples are sent with it."""
        self._works = False
        self._shared: SharedUpdate | None = None
        """The update that announced the newest sample, until its value is computed."""

    @property
    def waiting(self) -> int:
        """Number of queued samples."""
        made = len(self._fresh) + len(self._making) + len(self._past)
        return super().waiting + made

    def offer(self, sample: Sample) -> None:
        """Compute the value, then queue the sample."""
        if len(self.queue) + len(self._fresh) >= self.depth:
            if self.reliable:
                self.subscription.overrun(self)
                return
            (self.queue or self._fresh).popleft()
            self.dropped += 1
            self.subscription.skipped += 1
        self._fresh.append(sample)
        self._shared = self._view.shared(sample.seq)
        self._begin()

    def replay(self, samples: Iterable[Sample]) -> None:
        """Compute the value, then queue earlier samples ahead of all others."""
        self._past = deque(samples)
        self._begin()

    def _begin(self) -> None:
        if not self._works and (self._fresh or self._past):
            self._works = True
            self._view.begin(self._work())

    def _work(self) -> Generator[None]:
        try:
            while (outbox := self.outbox) is not None and (self._fresh or self._past):
                # Later samples may signal changes that this value does not include.
                self._making, self._fresh = self._fresh, deque()
                past, self._past = self._past, deque()
                encoding, *_ = self._heads or self._make_heads()
                shared, self._shared = self._shared, None
                made = yield from self._make(encoding, None if past else shared)
                if made is not None and self.outbox is outbox:
                    self._queue(made, past)
                self._making.clear()
        finally:
            self._works = False

    def _make(
        self, encoding: Encoding, shared: SharedUpdate | None
    ) -> Generator[None, None, _Made | None]:
        sees = self._view.sees
        steps = self._view.make(encoding)
        if shared is not None:
            steps = shared.make((sees, encoding), steps)
        try:
            value = yield from steps
            truncated = isinstance(value, Body) and value.truncated
            if isinstance(self.fields, tuple):
                value = project(value.value if isinstance(value, Body) else value, self.fields)
            return _Made(sees, encode_body(value, encoding), truncated)
        except Exception as error:  # a fault in the view drops this update and is logged
            to_internal_error(error, path=self.entry.path)
            return None

    def _queue(self, made: _Made, past: deque[Sample]) -> None:
        self._made = made
        if past:
            super().replay(past)
        for sample in self._making:
            super().offer(sample)

    def drain(self, out: list[bytes], budget: int, wrap: Wrap | None, big: int | None) -> int:
        """Move queued samples to `out`; a value computed for other rights is computed again first."""
        if self._made is not None and self._made.sees != self._view.sees:
            self._fresh.extendleft(reversed(self.queue))
            self._past = self.backlog or self._past
            self.queue.clear()
            self.backlog = None
            self._begin()
            return 0
        return super().drain(out, budget, wrap, big)

    def conflate(self) -> None:
        """Drop all queued samples but the newest."""
        if self._fresh or self._making or self._past:
            old = self.waiting - 1
            newest = (self._fresh or self._making or self._past)[-1]
            for held in (self._fresh, self._making, self._past, self.queue):
                held.clear()
            self.backlog = None
            self._fresh.append(newest)
            self.dropped += old
            self.subscription.skipped += old
            self._begin()
        else:
            super().conflate()

    def leave(self) -> None:
        """Drop the queue."""
        super().leave()
        for held in (self._fresh, self._making, self._past):
            held.clear()
        self._made = self._shared = None

    def _frame(self, sample: Sample) -> bytes:
        encoding, *_ = self._heads or self._make_heads()
        if type(self.fields) is Rendering:
            text = f"{self.entry.path} is different for each reader: it has no form of an adapter"
            raise UnsupportedOperation(text, path=self.entry.path)
        made = self._made
        assert made is not None
        facts: dict[str, Any] = {
            "type": "update",
            "id": self.subscription.id,
            "path": self.entry.path,
            "seq": sample.seq,
            "timestamp": sample.time,
        }
        if made.truncated:
            facts["truncated"] = True
        return encode_frame(facts, made.data, encoding)
