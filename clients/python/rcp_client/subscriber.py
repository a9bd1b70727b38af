"""The interface between a channel and its subscriptions."""

from __future__ import annotations

from typing import Protocol

from rcp_client.messages import Message, Notice
from rcp_protocol.errors import RcpError

__all__ = ["Subscriber"]


class Subscriber(Protocol):
    """Receives the updates and notices of one subscription."""

    seen: dict[str, int]
    """Sequence number of the last sample of each path."""

    def take(self, message: Message) -> None:
        """Handle an update."""

    def note(self, notice: Notice) -> None:
        """Handle a notice."""

    def fail(self, error: RcpError) -> None:
        """End with an error."""

    def restore(self, *, restarted: bool) -> None:
        """Re-establish the subscription on a new connection."""
