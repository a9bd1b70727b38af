"""What carries a session: one connection, whatever it is made of."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from rcp_client.messages import Codec, Message

__all__ = ["Carrier", "Dial", "Lost", "Received"]


class Carrier(Protocol):
    """The client's end of one connection; only for the event loop's thread."""

    segment_size: int | None
    """Longest frame the gateway accepts, once agreed; None: messages are sent whole."""

    @property
    def closed(self) -> bool:
        """Whether it has ended."""
        ...

    @property
    def why(self) -> str:
        """Why it has ended."""
        ...

    def send(self, envelope: dict[str, Any]) -> None:
        """Send an envelope; does nothing on a closed connection.

        :raises RcpError: the envelope cannot be encoded.
        """
        ...

    def close(self) -> None:
        """Close the connection; its end is reported as any other."""
        ...


Received = Callable[[Message, bytes], None]
Lost = Callable[[Carrier], None]
Dial = Callable[[Codec, Received, Lost], Awaitable[Carrier]]
"""Opens a connection, or raises `ConnectionLost`."""
