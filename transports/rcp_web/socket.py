"""The listener's native WebSocket handle `rcp.socket`, as a type."""

from __future__ import annotations

from typing import Protocol

__all__ = ["NativeSocket", "Receiver"]


class Receiver(Protocol):
    """The callbacks of a socket."""

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
        """Reply to a text message that is not UTF-8; the socket closes afterwards."""
        ...

    def oversized(self, size: int) -> None:
        """Reply to a message that was discarded because of its size."""
        ...

    def drained(self) -> None:
        """Resume writing."""
        ...

    def lost(self, code: int) -> None:
        """Release the connection: the socket is closed."""
        ...


class NativeSocket(Protocol):
    """An open WebSocket, bypassing ASGI."""

    writable: bool
    """Whether the write buffer has room; `Receiver.drained` is called when it has again."""
    open: bool
    limit: int
    """Maximum length of a received message, reassembled and decompressed."""
    compresses: bool
    """Whether messages are compressed individually, so that frames cannot be prebuilt."""

    @property
    def buffered(self) -> int:
        """Number of bytes that the client has not read yet."""
        ...

    def attach(self, receiver: Receiver) -> None:
        """Replace the receiver."""
        ...

    def write(self, messages: list[bytes]) -> None:
        """Send whole messages in one write; JSON objects as text, others as binary."""
        ...

    def reply(self, data: bytes) -> None:
        """Send one message, uncompressed."""
        ...

    def head(self, size: int, text: bool) -> bytes:  # noqa: FBT001 - a frame's own flag
        """Return the head of a frame around a whole message of `size` bytes."""
        ...

    def pass_on(self, parts: list[bytes]) -> int | None:
        """Send framed data if there is room for it.

        Return how many bytes are unread since, 0 if there is still room; None if there was none.
        """
        ...

    def write_frames(self, parts: list[bytes]) -> None:
        """Send framed data."""
        ...

    def pause_reading(self) -> None:
        """Stop reading; messages that were already read are still delivered."""
        ...

    def resume_reading(self) -> None:
        """Resume reading."""
        ...

    def close(self, code: int, reason: str = "") -> None:
        """Start the closing handshake."""
        ...
