"""Values in the frames that clients name: the interface of the feature that converts them, and goals."""

from __future__ import annotations

from typing import Any, Protocol

from rcp_kernel.access.acl import Rights
from rcp_kernel.errors import FilterUnsupported
from rcp_kernel.features.services import ServiceKey
from rcp_kernel.sessions.outbox import Outbox
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_kernel.values import ValueType
from rcp_kernel.wire import Request
from rcp_streams.path_subscription import PathSubscription, Subscriber

__all__ = ["FRAMES", "FrameConverter", "FrameView", "NoFrames"]


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


class FrameConverter(Protocol):
    """Converts what robots measure to the frames that clients name, and goals from them."""

    def converts(self, entry: Entry) -> bool:
        """Return whether a resource's values are of a kind that is converted."""
        ...

    def view(self, session: Session, entry: Entry, frame: str) -> FrameView:
        """Return a resource's values in a frame, which need not be known yet.

        The session's current rights are applied at each conversion.

        :raises FilterUnsupported: its values are not of a kind that is converted.
        """
        ...

    def known(self, rights: Rights, entry: Entry) -> list[str]:
        """Return the frames to or from which a resource's values are converted, for discovery."""
        ...

    def command_schema(
        self, entry: Entry, frames: list[str], schema: dict[str, Any]
    ) -> dict[str, Any] | None:
        """Return the schema of a command widened by what `frames` allow; None: as it is."""
        ...

    def takes(self, entry: Entry) -> bool:
        """Return whether a resource's input is a goal in a frame; asked once, as its type stays."""
        ...

    def goal(self, session: Session, request: Request, entry: Entry) -> Any:
        """Return the input of a request in a frame that the robot takes; None: it is so already.

        Called for the resources that `takes` accepts.

        :raises RcpError: it names a frame from which nothing leads to one that the robot takes.
        """
        ...


FRAMES: ServiceKey[FrameConverter] = ServiceKey("frames")
"""The service of the feature that converts; without one, `NoFrames`."""


class NoFrames:
    """The converter of a gateway without that feature: goals are passed to the robots unchanged."""

    def converts(self, entry: Entry) -> bool:
        """Convert nothing."""
        return False

    def view(self, session: Session, entry: Entry, frame: str) -> FrameView:
        """Refuse."""
        raise FilterUnsupported(
            "this gateway does not convert values to other frames",
            path=entry.path,
            remedy="Omit `frame`.",
        )

    def known(self, rights: Rights, entry: Entry) -> list[str]:
        """Know no frames."""
        return []

    def command_schema(
        self, entry: Entry, frames: list[str], schema: dict[str, Any]
    ) -> dict[str, Any] | None:
        """Widen nothing."""
        return None

    def takes(self, entry: Entry) -> bool:
        """Take none."""
        return False

    def goal(self, session: Session, request: Request, entry: Entry) -> Any:
        """Convert nothing."""
        return None
