"""Who is told of what comes in by a WebSocket."""

from __future__ import annotations

from typing import Protocol

__all__ = ["Receiver"]


class Receiver(Protocol):
    """Who uses the socket."""

    def received(self, data: bytes, text: bool) -> None:  # noqa: FBT001 - a frame's own flag
        """Take one whole message."""
        ...

    def other_frame(self) -> None:
        """Take notice of a frame that is no whole message, but takes its time as well."""
        ...

    def settled(self) -> None:
        """Take notice that the last frame of what was read has been told of."""
        ...

    def garbled(self, data: bytes) -> None:
        """Take notice of a text message that is not UTF-8; the socket closes after it."""
        ...

    def oversized(self, size: int) -> None:
        """Take notice of a message that was too long and was thrown away."""
        ...

    def drained(self) -> None:
        """Take notice that the socket is writable again."""
        ...

    def lost(self, code: int) -> None:
        """Take notice of the end, with the close code (1006: none)."""
        ...
