"""Frames on request: the interface of the feature that converts values and goals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from rcp_kernel.access.acl import Rights
from rcp_kernel.errors import FilterUnsupported
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_kernel.values import ValueType
from rcp_kernel.wire import Request

__all__ = ["FrameConverter", "FrameView", "NoFrames"]


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

    @property
    def remote(self) -> bool:
        """Whether the robot's own gateway converts: see `follow`."""
        ...

    def follow(
        self,
        entry: Entry,
        rate: float | None,
        offer: Callable[[Sample], None],
        missing: Callable[[str], None],
    ) -> Callable[[], None]:
        """Have the robot's own gateway send its values in the frame; return the end function.

        `entry` is the resource as it is declared now. `missing` is told why there are none for now.
        """
        ...


class FrameConverter(Protocol):
    """Converts what robots measure to the frames that clients name, and goals from them."""

    def converts(self, entry: Entry) -> bool:
        """Return whether a resource's values are of a kind that is converted."""
        ...

    def view(self, session: Session, entry: Entry, frame: str) -> FrameView:
        """Return a resource's values in a frame, which need not be known yet.

        It keeps to the rights that the session has at each conversion.

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

    def goal(self, session: Session, request: Request, entry: Entry) -> Any:
        """Return the input of a request in a frame that the robot takes; None: it is so already.

        :raises RcpError: it names a frame from which nothing leads to one that the robot takes.
        """
        ...


class NoFrames:
    """A gateway without that feature: goals are left to the robots."""

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

    def goal(self, session: Session, request: Request, entry: Entry) -> Any:
        """Convert nothing."""
        return None
