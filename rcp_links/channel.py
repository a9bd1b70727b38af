"""One connection with a device, as a link uses it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from typing import Protocol, TypeVar

__all__ = ["Channel", "Connect"]

M = TypeVar("M")


class Channel(Protocol[M]):
    """Messages of one connection, in both directions."""

    def send(self, message: M) -> None:
        """Hand a message over to be sent; never waits.

        :raises OSError: the connection is lost.
        """
        ...

    async def receive(self) -> M:
        """Return the next message.

        :raises OSError, EOFError: the connection is lost.
        :raises ValueError: what was received is no message.
        """
        ...


Connect = Callable[[], AbstractAsyncContextManager[Channel[M]]]
"""Opens a connection, which leaving the context closes without waiting for the device.

Entering it raises OSError where the device cannot be reached.
"""
