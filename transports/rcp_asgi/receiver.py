"""The callbacks of an open WebSocket."""

from __future__ import annotations

from typing import Protocol

__all__ = ["Receiver"]


class Receiver(Protocol):
    """The user of a socket."""

    def received(self, data: bytes, text: bool) -> None:  # noqa: FBT001 - a frame's own flag
        """Handle a whole message."""
        ...

    def other_frame(self) -> None:
        """Handle a frame that is not a whole message, but costs time as well."""
        ...

    def settled(self) -> None:
        """Handle the end of a read: all its frames were delivered."""
        ...

    def garbled(self, data: bytes) -> None:
        """Handle a text message that is not UTF-8; the socket closes afterwards."""
        ...

    def oversized(self, size: int) -> None:
        """Handle a message that was too long and was discarded."""
        ...

    def drained(self) -> None:
        """Handle a socket that is writable again."""
        ...

    def lost(self, code: int) -> None:
        """Handle the end of the connection, with the close code (1006: none)."""
        ...
