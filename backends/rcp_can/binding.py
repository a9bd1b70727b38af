"""The parts of the backend that read, write or execute resources."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any

from rcp_kernel.errors import AdapterUnavailable, RcpError, UnsupportedOperation
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress

__all__ = ["Part"]


class Part:
    """A part of the backend with its own resources; operations it does not override are refused."""

    def resources(self) -> list[Resource]:
        """List its resources."""
        return []

    async def read(self, name: str) -> Any:
        """Return a fresh value.

        :raises AdapterUnavailable: there is no value yet.
        """
        raise AdapterUnavailable(f"'{name}' has no value yet", remedy="Subscribe to it.")

    async def write(self, name: str, value: Any) -> Any:
        """Write a value."""
        raise UnsupportedOperation(f"'{name}' cannot be written")

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or service."""
        raise UnsupportedOperation(f"'{name}' cannot be executed")

    def foresee(self, name: str, value: Any) -> None:
        """Refuse a dry run of what `execute` would refuse now."""

    def watch(self, name: str) -> AbstractContextManager[object]:
        """Keep a resource published while entered."""
        return nullcontext()

    async def halt(self) -> None:
        """Stop everything that moves; return when the drive has confirmed it."""

    async def hold(self, reason: RcpError) -> None:
        """Bring everything to rest without switching it off; commands end with `reason`."""

    def hold_stop(self) -> None:
        """Repeat the stop if anything is not at rest."""
