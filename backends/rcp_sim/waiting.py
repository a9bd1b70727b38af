"""Waiting for conditions in the simulation, checked once per tick."""

from __future__ import annotations

from collections.abc import Callable

import anyio

from rcp_kernel.errors import AdapterUnavailable

__all__ = ["Waiting"]


class Waiting:
    """Coroutines that wait for a condition in the simulated world."""

    def __init__(self) -> None:
        self._waiters: list[tuple[Callable[[], bool], anyio.Event]] = []
        self._closed: str | None = None

    async def until(self, holds: Callable[[], bool]) -> None:
        """Return once `holds()` is true.

        :raises AdapterUnavailable: the simulation ended first.
        """
        if holds():
            return
        if self._closed is None:
            waiter = holds, anyio.Event()
            self._waiters.append(waiter)
            try:
                await waiter[1].wait()
            finally:
                if waiter in self._waiters:
                    self._waiters.remove(waiter)
        if self._closed is not None:
            raise AdapterUnavailable(self._closed)

    def poll(self) -> None:
        """Wake the waiters whose condition is true."""
        if self._waiters:
            for holds, event in self._waiters:
                if holds():
                    event.set()
            self._waiters = [waiter for waiter in self._waiters if not waiter[1].is_set()]

    def close(self, reason: str) -> None:
        """Wake all waiters; their calls fail."""
        self._closed = reason
        for _, event in self._waiters:
            event.set()
        self._waiters.clear()
