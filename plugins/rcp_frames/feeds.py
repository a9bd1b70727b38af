"""Feeds whose values are sent in a frame that the client names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from rcp_kernel.contract.internal_errors import to_internal_error
from rcp_kernel.errors import RcpError
from rcp_kernel.sessions.notices import notice
from rcp_kernel.sessions.outbox import FlushScheduler, Outbox
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_streams.filtered import FilteredPathSubscription
from rcp_streams.path_subscription import Subscriber

__all__ = ["ConvertedFeed", "RemoteFeed"]


class ConvertingView(Protocol):
    """The values of one resource, converted here."""

    def convert(self, sample: Sample) -> Sample:
        """Return a sample in the frame.

        :raises RcpError: its value is invalid, or there is no transform for its time.
        """
        ...


class RemoteView(Protocol):
    """The values of one resource, converted by the robot's own gateway."""

    def follow(
        self,
        entry: Entry,
        rate: float | None,
        offer: Callable[[Sample], None],
        missing: Callable[[str], None],
    ) -> Callable[[], None]:
        """Have the gateway send its values; return the end function.

        `entry` is the resource as it is declared now. `missing` is called with the reason why there
        are none for now.
        """
        ...


class ConvertedFeed(FilteredPathSubscription):
    """A path of a subscription that names a frame; filters see the converted values."""

    __slots__ = ("_told", "_view")

    def __init__(
        self, subscription: Subscriber, entry: Entry, outbox: Outbox | None, view: ConvertingView
    ) -> None:
        super().__init__(subscription, entry, outbox)
        self._view = view
        self._told = False
        """Whether the client knows that samples are missing for want of a transform."""

    def offer(self, sample: Sample) -> None:
        """Queue a sample in the frame."""
        if (converted := self._converted(sample)) is not None:
            super().offer(converted)

    def admit(self, sample: Sample) -> Sample | None:
        """Return an earlier sample in the frame, if it passes the filters."""
        converted = self._converted(sample)
        return None if converted is None else super().admit(converted)

    def _converted(self, sample: Sample) -> Sample | None:
        try:
            converted = self._view.convert(sample)
        except Exception as error:
            self._tell(to_internal_error(error, path=self.entry.path))
            return None
        self._told = False
        return converted

    def _tell(self, error: RcpError) -> None:
        if not self._told:
            self._told = True
            _tell_missing(self, error.message)


class RemoteFeed(FilteredPathSubscription):
    """A path in a frame that only the robot's own gateway knows: its values come converted."""

    remote = True

    __slots__ = ("_end", "_last", "_returned", "_told", "_view")

    def __init__(
        self, subscription: Subscriber, entry: Entry, outbox: Outbox | None, view: RemoteView
    ) -> None:
        super().__init__(subscription, entry, outbox)
        self._view = view
        self._end: Callable[[], None] | None = None
        self._last: int | None = None
        """Number of the last value received, or sent before the client returned; None: there was none."""
        self._told: str | None = None
        """Why values are missing, as the client knows."""
        self._returned = False
        """Whether the client has returned, and what it missed was not kept."""

    def listen(self, scheduler: FlushScheduler) -> None:
        """Start to receive values from the robot's own gateway."""
        self.entry.framed += (self,)
        self.follow()

    def unlisten(self) -> bool:
        """Stop receiving values; return whether any were received."""
        self._told = self._last = None
        if self._end is not None:
            self._end()
            self._end = None
        known = self in self.entry.framed
        self.entry.framed = tuple(one for one in self.entry.framed if one is not self)
        return known

    def follow(self) -> None:
        """Continue with the current rights and backend."""
        before = self._end
        if self.kept:
            self._returned, self._last = True, self.sent
        rate = self.subscription.options.rate
        self._end = self._view.follow(self.entry, rate, self._receive, self._miss)
        if before is not None:
            before()

    def admit(self, sample: Sample) -> Sample | None:
        """Return nothing: earlier values are not kept in the frame."""
        return None

    def _receive(self, sample: Sample) -> None:
        self.heard, self._told = self.entry.clock.monotonic(), None
        last = self._last
        if last is not None and sample.seq <= last:
            return
        self._last = sample.seq
        if self._returned:
            self._returned = False
            self._tell_gap(sample.seq)
        elif last is None and not self.subscription.options.initial:
            super().admit(sample)  # the filters know it
            return
        self.offer(sample)

    def _tell_gap(self, seq: int) -> None:
        lost = seq - self.sent - 1
        if lost > 0 and self.sent:  # nothing is known of another run of this gateway
            path = self.entry.path
            why = f"samples of {path} are not kept in other frames"
            facts = {"lost": lost, "first": self.sent + 1, "last": seq - 1, "message": why}
            notice(self.outbox, "gap", id=self.subscription.id, path=path, **facts)

    def _miss(self, why: str) -> None:
        if why != self._told:
            self._told = why
            _tell_missing(self, why)


def _tell_missing(feed: FilteredPathSubscription, why: str) -> None:
    facts = {"id": feed.subscription.id, "path": feed.entry.path, "message": why}
    notice(feed.outbox, "no_transform", **facts)
