"""Feeds whose values are sent in a frame that the client names."""

from __future__ import annotations

from typing import Protocol

from rcp_kernel.contract.pending import to_internal_error
from rcp_kernel.errors import RcpError
from rcp_kernel.streams.filtered import FilteredPathSubscription
from rcp_kernel.streams.notices import notice
from rcp_kernel.streams.outbox import Outbox
from rcp_kernel.streams.path_subscription import Subscriber
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_kernel.values import ValueType

__all__ = ["FrameView", "FramedPathSubscription"]


class FrameView(Protocol):
    """The values of one resource in another frame."""

    @property
    def value_type(self) -> ValueType:
        """The type of the converted values."""
        ...

    def check(self) -> None:
        """Make sure that values can be converted as things are.

        :raises InvalidValue: there is no such frame, or nothing connects it to the values' own.
        """
        ...

    def convert(self, sample: Sample) -> Sample:
        """Return a sample in the frame; the same one for all who ask for it.

        :raises RcpError: its value is invalid, or there is no transform for its time.
        """
        ...


class FramedPathSubscription(FilteredPathSubscription):
    """A path of a subscription that names a frame; filters see the converted values."""

    __slots__ = ("_told", "_view")

    def __init__(
        self, subscription: Subscriber, entry: Entry, outbox: Outbox | None, view: FrameView
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
            facts = {"id": self.subscription.id, "path": self.entry.path, "message": error.message}
            notice(self.outbox, "no_transform", **facts)
