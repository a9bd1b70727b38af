"""Waiting for the simulation: conditions that are looked at once a tick."""

from __future__ import annotations

from collections.abc import Callable

import anyio

from rcp_kernel.errors import AdapterUnavailable

__all__ = ["Waiting"]


class Waiting:
    """Coroutines that wait until something holds in the simulated world."""

    def __init__(self) -> None:
        self._waiters: list[tuple[Callable[[], bool], anyio.Event]] = []
        self._closed: str | None = None

    async def until(self, holds: Callable[[], bool]) -> None:
        """Return once `holds()` is true; at once if it is already.

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
        """Wake those whose condition has come true."""
        if self._waiters:
            for holds, event in self._waiters:
                if holds():
                    event.set()
            self._waiters = [waiter for waiter in self._waiters if not waiter[1].is_set()]

    def close(self, reason: str) -> None:
        """Wake everybody, to be told that nothing will come any more."""
        self._closed = reason
        for _, event in self._waiters:
            event.set()
        self._waiters.clear()
