"""The body of an endless response, past ASGI: no task is woken and no message is made for a write.

It is `scope["extensions"]["rcp.stream"]`, to be used after `http.response.start` was sent without
a content length, until the last `http.response.body`.
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
        """Whether the write buffer has room, and somebody is there to empty it."""
        self.drained: Callable[[], None] | None = None
        """Called when `writable` has become true again; set by who writes."""

    def write(self, data: bytes) -> None:
        """Send one chunk; it must not be empty."""
        if not self._transport.is_closing():
            self._transport.write(b"%x\r\n%b\r\n" % (len(data), data))

    def abort(self) -> None:
        """Cut the connection: what waits for the client is not waited for."""
        self._transport.abort()

    def resume(self) -> None:
        """Take notice that the socket takes something again."""
        self.writable = True
        if self.drained is not None:
            self.drained()
