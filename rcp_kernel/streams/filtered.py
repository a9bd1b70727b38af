"""Feeds that send less than every sample, or something else than the sample: filters and views."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from rcp_kernel.contract.pending import to_internal_error
from rcp_kernel.errors import RcpError
from rcp_kernel.streams.filters import Change
from rcp_kernel.streams.outbox import Outbox
from rcp_kernel.streams.path_subscription import PathSubscription, Subscriber
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample, masked, project
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Body, encode_body, encode_frame

__all__ = ["FilteredPathSubscription", "ViewSubscription", "VisibilityFilteredSubscription"]

_LONGEST = 86_400.0  # s between updates, however low the rate


class FilteredPathSubscription(PathSubscription):
    """One path of a subscription that asked for less than every sample."""

    judges = True

    __slots__ = ("_armed", "_change", "_due", "_held", "_interval", "_monotonic", "_where")

    def __init__(self, subscription: Subscriber, entry: Entry, outbox: Outbox | None) -> None:
        super().__init__(subscription, entry, outbox)
        options = subscription.options
        self._where = subscription.where.fresh() if subscription.where else None
        wants_change = options.on == "change" or options.deadband is not None
        self._change = Change(options.deadband, options.fields) if wants_change else None
        self._interval = min(1.0 / options.rate, _LONGEST) if options.rate else 0.0
        self._monotonic = entry.clock.monotonic
        self._due = 0.0
        self._held: Sample | None = None
        self._armed = False
        """Whether a timer will look at what is held."""

    def offer(self, sample: Sample) -> None:
        """Queue a sample if every filter lets it through, later if the rate does not yet."""
        if self._where is not None and not self._passes(sample):
            return
        if self._interval:
            wait = self._due - self._monotonic()
            # A tenth of the period is forgiven: a source at the wanted rate has jitter too.
            if wait > self._interval * 0.1:
                self._held = sample
                self._arm(wait)
                return
            self._held = None
        self._emit(sample)

    def _arm(self, wait: float) -> None:
        if not self._armed:
            self._armed = True
            self.subscription.later(wait, self._release)

    def _release(self) -> None:
        self._armed = False
        if self._held is None or self.outbox is None:
            return
        # A sample may have gone out by the allowance since: what is held waits for its own beat.
        wait = self._due - self._monotonic()
        if wait > self._interval * 0.1:
            self._arm(wait)
            return
        sample, self._held = self._held, None
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
            # Keep the beat of the period where possible, so that the mean rate is the one asked for.
            self._due = (self._due if late < self._interval else moment) + self._interval
        super().offer(sample)

    def _passes(self, sample: Sample) -> bool:
        assert self._where is not None
        try:
            return self._where.passes(sample.value)
        except RcpError:
            return False

    def replay(self, samples: Iterable[Sample]) -> None:
        """Queue earlier samples; the next new one keeps the rate's distance from them."""
        super().replay(samples)
        if self.backlog and self._interval:
            self._due = self._monotonic() + self._interval

    def admit(self, sample: Sample) -> Sample | None:
        """Return an earlier sample that passes; the rate does not hold the past back."""
        if self._where is not None and not self._passes(sample):
            return None
        if self._change is None:
            return sample
        try:
            return sample if self._change.passes(sample.value) else None
        except RcpError:
            return None

    def prime(self, sample: Sample) -> None:
        """Let the filters see the present value, without sending it."""
        self.admit(sample)

    def leave(self) -> None:
        """Forget what waits and what was held back."""
        super().leave()
        self._held = None


class VisibilityFilteredSubscription(FilteredPathSubscription):
    """A path of which everybody sees some samples only, or parts of them."""

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
        """Queue what this principal may see of a sample."""
        # The filters come after: what is hidden must not show in what they let through.
        if (told := self._told(sample)) is not None:
            super().offer(told)

    def admit(self, sample: Sample) -> Sample | None:
        """Return what may be seen of an earlier sample, and passes."""
        told = self._told(sample)
        return None if told is None else super().admit(told)

    def _told(self, sample: Sample) -> Sample | None:
        return masked(sample, self._shown)


class ViewSubscription(PathSubscription):
    """A path whose value depends on who asks: a sample only says that it changed."""

    __slots__ = ("_view",)

    def __init__(
        self,
        subscription: Subscriber,
        entry: Entry,
        outbox: Outbox | None,
        view: Callable[[Encoding], Any],
    ) -> None:
        super().__init__(subscription, entry, outbox)
        self._plain = False
        self._view = view

    def _frame(self, sample: Sample) -> bytes:
        encoding, *_ = self._heads or self._make_heads()
        facts: dict[str, Any] = {
            "type": "update",
            "id": self.subscription.id,
            "path": self.entry.path,
            "seq": sample.seq,
            "timestamp": sample.time,
        }
        try:
            value = self._view(encoding)
            if isinstance(value, Body) and value.cut:
                facts["truncated"] = True
            if self.fields is not None:
                value = project(value.value if isinstance(value, Body) else value, self.fields)
            return encode_frame(facts, encode_body(value, encoding), encoding)
        except Exception as error:
            raise to_internal_error(error, path=self.entry.path) from error
