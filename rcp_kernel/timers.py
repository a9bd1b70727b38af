"""Many timers on one of the event loop's: the many are cheap to set, and none is ever taken back."""

from __future__ import annotations

import asyncio
import heapq
import itertools
from collections.abc import Callable

__all__ = ["Timers"]


class Timers:
    """What is to be called later."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._alarm: asyncio.TimerHandle | None = None

    def later(self, delay: float, function: Callable[[], None]) -> None:
        """Call a function after `delay` seconds; one timer serves all."""
        due = self._loop.time() + delay
        heapq.heappush(self._due, (due, next(self._count), function))
        if self._alarm is None or due < self._alarm.when():
            if self._alarm is not None:
                self._alarm.cancel()
            self._alarm = self._loop.call_at(due, self._ring)

    def _ring(self) -> None:
        self._alarm = None
        moment = self._loop.time() + 0.0005
        try:
            while self._due and self._due[0][0] <= moment:
                heapq.heappop(self._due)[2]()
        finally:  # one that raises must not silence the others
            if self._due and self._alarm is None:
                self._alarm = self._loop.call_at(self._due[0][0], self._ring)

    def close(self) -> None:
        """Call nothing any more."""
        if self._alarm is not None:
            self._alarm.cancel()
