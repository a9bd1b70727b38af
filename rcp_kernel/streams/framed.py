"""The values of a resource in a frame that the client names."""

from __future__ import annotations

from typing import Protocol

from rcp_kernel.streams.outbox import Outbox
from rcp_kernel.streams.path_subscription import PathSubscription, Subscriber
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_kernel.values import ValueType

__all__ = ["FrameView"]


class FrameView(Protocol):
    """The values of one resource in another frame, for one session."""

    @property
    def value_type(self) -> ValueType:
        """The type of the converted values."""
        ...

    @property
    def remote(self) -> bool:
        """Whether the robot's own gateway converts, and sends the values: see `Entry.framed`."""
        ...

    def check(self) -> None:
        """Make sure that values can be converted at the moment.

        :raises InvalidValue: there is no such frame, or nothing connects it to the values' own.
        """
        ...

    def convert(self, sample: Sample) -> Sample:
        """Return a sample in the frame; the same one for all sessions with the same rights.

        :raises RcpError: its value is invalid, or there is no transform for its time.
        """
        ...

    def feed(
        self, subscription: Subscriber, entry: Entry, outbox: Outbox | None
    ) -> PathSubscription:
        """Create the feed of a subscription that names the frame."""
        ...
