"""Many timers on one of the event loop's: the many are cheap to set, and none is ever taken back."""

from __future__ import annotations

import asyncio
import heapq
import itertools
from collections.abc import Callable

__all__ = ["Timers"]


class Timers:
    """Scheduled callbacks."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._alarm: asyncio.Handle | None = None
        self._rings = 0.0
        """Time of the next alarm: uvloop does not report it if it is less than half a
        millisecond away."""

    def later(self, delay: float, function: Callable[[], None]) -> None:
        """Call a function after `delay` seconds; one timer serves all."""
        due = self._loop.time() + delay
        heapq.heappush(self._due, (due, next(self._count), function))
        if self._alarm is None or due < self._rings:
            if self._alarm is not None:
                self._alarm.cancel()
            self._set(due)

    def _ring(self) -> None:
        self._alarm = None
        moment = self._loop.time() + 0.0005
        try:
            while self._due and self._due[0][0] <= moment:
                heapq.heappop(self._due)[2]()
        finally:  # one that raises must not silence the others
            if self._due and self._alarm is None:
                self._set(self._due[0][0])

    def _set(self, due: float) -> None:
        self._alarm = self._loop.call_at(due, self._ring)
        self._rings = due

    def close(self) -> None:
        """Call nothing any more."""
        if self._alarm is not None:
            self._alarm.cancel()
