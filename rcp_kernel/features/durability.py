"""What a reply confirms beside the act itself: a record of it that is kept."""

from __future__ import annotations

from typing import Protocol

from rcp_kernel.sessions.session import Answer
from rcp_kernel.wire import Reply

__all__ = ["Durability"]


class Durability(Protocol):
    """Lets replies to writes, commands and recorded refusals leave once their record is kept.

    The robot waits for nothing, and reads and subscriptions are never held.
    """

    def check(self) -> None:
        """Refuse a write or command now whose record could not be kept; never asked about holds.

        :raises QueueFull: it could not.
        """
        ...

    def hold(self, send: Answer, until: float, reply: Reply) -> None:
        """Send a reply now, or once all that was told so far is kept.

        `until` is the time of the event loop at which its client waits no longer.
        """
        ...

    def hold_estop(self, send: Answer, reply: Reply) -> None:
        """Do as `hold` does for the reply to an e-stop, which is sent soon in any case."""
        ...
