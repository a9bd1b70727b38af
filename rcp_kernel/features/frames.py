"""Frames on request: the interface of the feature that converts values and goals."""

from __future__ import annotations

from typing import Any, Protocol

from rcp_kernel.access.acl import Rights
from rcp_kernel.errors import FilterUnsupported
from rcp_kernel.sessions.session import Session
from rcp_kernel.streams.framed import FrameView
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Request

__all__ = ["FrameConverter", "NoFrames"]


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

    def takes(self, entry: Entry) -> bool:
        """Return whether a resource's input is a goal in a frame; asked once, as its type stays."""
        ...

    def goal(self, session: Session, request: Request, entry: Entry) -> Any:
        """Return the input of a request in a frame that the robot takes; None: it is so already.

        Called for the resources that `takes` accepts.

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

    def takes(self, entry: Entry) -> bool:
        """Take none."""
        return False

    def goal(self, session: Session, request: Request, entry: Entry) -> Any:
        """Convert nothing."""
        return None
