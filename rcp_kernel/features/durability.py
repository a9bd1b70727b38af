"""Durability of audit records: a reply is sent only once its record is stored."""

from __future__ import annotations

from typing import Protocol

from rcp_kernel.sessions.session import Answer
from rcp_kernel.wire import Reply

__all__ = ["Durability"]


class Durability(Protocol):
    """Delays replies to writes, commands and recorded refusals until their records are stored.

    Commands to robots are not delayed, and neither are reads and subscriptions.
    """

    def check(self) -> None:
        """Refuse a write or command whose record could not be stored; not called for holds.

        :raises QueueFull: the record could not be stored.
        """
        ...

    def send_when_stored(self, send: Answer, until: float, reply: Reply) -> None:
        """Send a reply now, or once all records so far are stored.

        `until` is the event loop time at which the client stops waiting.
        """
        ...

    def send_estop_when_stored(self, send: Answer, reply: Reply) -> None:
        """Send the reply to an e-stop as `send_when_stored`, but soon in any case."""
        ...
