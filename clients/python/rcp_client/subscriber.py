"""What a channel needs to know of a subscription."""

from __future__ import annotations

from typing import Protocol

from rcp_client.messages import Message, Notice
from rcp_protocol.errors import RcpError

__all__ = ["Subscriber"]


class Subscriber(Protocol):
    """Receives the updates and notices of one subscription."""

    seen: dict[str, int]
    """Number of the last sample of each path."""

    def take(self, message: Message) -> None:
        """Take an update."""

    def note(self, notice: Notice) -> None:
        """Take a notice."""

    def fail(self, error: RcpError) -> None:
        """End with an error."""

    def restore(self, *, restarted: bool) -> None:
        """Make sure that the subscription stands on a new connection."""
