"""The body of an endless response, bypassing ASGI: a write needs no task and no message.

It is `scope["extensions"]["rcp.stream"]`, available between `http.response.start` without a content
length and the last `http.response.body`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

__all__ = ["Endless"]


class Endless:
    """Writes chunks (RFC 9112, 7.1) to one connection."""

    __slots__ = ("_transport", "drained", "writable")

    def __init__(self, transport: asyncio.Transport) -> None:
        self._transport = transport
        self.writable = True
        """Whether the write buffer has room and the client is connected."""
        self.drained: Callable[[], None] | None = None
        """Called when `writable` becomes true again; set by the writer."""

    def write(self, data: bytes) -> None:
        """Send one chunk; it must not be empty."""
        if not self._transport.is_closing():
            self._transport.write(b"%x\r\n%b\r\n" % (len(data), data))

    def abort(self) -> None:
        """Close the connection at once, discarding buffered data."""
        self._transport.abort()

    def resume(self) -> None:
        """Handle a socket that is writable again."""
        self.writable = True
        if self.drained is not None:
            self.drained()
