"""What stands behind a resource: the part of the backend that reads, writes or executes it."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any

from rcp_kernel.errors import AdapterUnavailable, RcpError, UnsupportedOperation
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress

__all__ = ["Part"]


class Part:
    """A part of the backend with resources of its own; refuses what it does not override."""

    def resources(self) -> list[Resource]:
        """List what it declares."""
        return []

    async def read(self, name: str) -> Any:
        """Return a fresh value.

        :raises AdapterUnavailable: there is none: nothing has happened, or been commanded, yet.
        """
        raise AdapterUnavailable(f"'{name}' has no value yet", remedy="Subscribe to it.")

    async def write(self, name: str, value: Any) -> Any:
        """Bring a value into force."""
        raise UnsupportedOperation(f"'{name}' cannot be written")

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or service."""
        raise UnsupportedOperation(f"'{name}' cannot be executed")

    def watch(self, name: str) -> AbstractContextManager[object]:
        """Keep a resource published while entered."""
        return nullcontext()

    async def halt(self) -> None:
        """Bring what moves to rest; return when the drive confirmed it."""

    async def hold(self, reason: RcpError) -> None:
        """Bring what moves to rest without switching it off; commands end for `reason`."""

    def hold_stop(self) -> None:
        """Send again what keeps it stopped, if it does not rest."""
