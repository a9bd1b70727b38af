"""What this transport wants of the listener: the native handle `rcp.socket`, as a type."""

from __future__ import annotations

from typing import Protocol

__all__ = ["NativeSocket", "Receiver"]


class Receiver(Protocol):
    """Who is told of what comes in."""

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
        """Answer a text message that is not UTF-8, at once: the socket closes after it."""
        ...

    def oversized(self, size: int) -> None:
        """Answer a message that was thrown away because it was too long."""
        ...

    def drained(self) -> None:
        """Go on writing."""
        ...

    def lost(self, code: int) -> None:
        """Let go: the socket is closed."""
        ...


class NativeSocket(Protocol):
    """An open WebSocket without ASGI in between."""

    writable: bool
    """Whether the write buffer has room; `Receiver.drained` tells when it has again."""
    open: bool
    limit: int
    """Longest message that is taken once it is put together and inflated."""
    compresses: bool
    """Whether messages are compressed one by one, so that frames cannot be made beforehand."""

    @property
    def buffered(self) -> int:
        """Bytes written that the client has not taken."""
        ...

    def attach(self, receiver: Receiver) -> None:
        """Have everything told to `receiver`."""
        ...

    def write(self, messages: list[bytes]) -> None:
        """Send whole messages in one write; JSON objects go as text, all else as binary."""
        ...

    def reply(self, data: bytes) -> None:
        """Send one message, uncompressed."""
        ...

    def head(self, size: int, text: bool) -> bytes:  # noqa: FBT001 - a frame's own flag
        """Return the head of a frame around a whole message of `size` bytes."""
        ...

    def pass_on(self, parts: list[bytes]) -> bool:
        """Send what is framed already if there is room for it; tell whether there was."""
        ...

    def write_frames(self, parts: list[bytes]) -> None:
        """Send what is framed already."""
        ...

    def pause_reading(self) -> None:
        """Take nothing more from the client; what was read already still comes."""
        ...

    def resume_reading(self) -> None:
        """Go on reading."""
        ...

    def close(self, code: int, reason: str = "") -> None:
        """Begin the closing handshake."""
        ...
