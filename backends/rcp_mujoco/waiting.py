"""Waiting for what happens in the simulation."""

from __future__ import annotations

from collections.abc import Callable

import anyio

from rcp_kernel.errors import AdapterUnavailable

__all__ = ["Waiting"]


class Waiting:
    """Coroutines waiting for conditions, which are checked after each step of the simulation."""

    def __init__(self) -> None:
        self._waiters: list[tuple[Callable[[], bool], anyio.Event]] = []
        self._closed: str | None = None

    async def until(self, holds: Callable[[], bool]) -> None:
        """Return once `holds()` is true.

        :raises AdapterUnavailable: the simulation ended first.
        """
        if self._closed is None and not holds():
            waiter = holds, anyio.Event()
            self._waiters.append(waiter)
            try:
                await waiter[1].wait()
            finally:
                self._waiters.remove(waiter)
        if self._closed is not None:
            raise AdapterUnavailable(self._closed)

    def poll(self) -> None:
        """Wake the coroutines whose condition is true."""
        for holds, event in self._waiters:
            if not event.is_set() and holds():
                event.set()

    def close(self, reason: str) -> None:
        """Wake all coroutines; their calls fail."""
        self._closed = reason
        for _, event in self._waiters:
            event.set()
