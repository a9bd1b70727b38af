"""Many timers on one of the event loop's, which take 2 µs to set and to cancel."""

from __future__ import annotations

import asyncio
import heapq
import itertools
from collections.abc import Callable, Hashable
from contextvars import Context

__all__ = ["Deadlines", "Timers", "moment_of"]

_SLOTS = 64  # per second
_EARLY = 0.001  # s that uvloop may call before the time


def moment_of(slot: int) -> float:
    """Return when the deadlines of a slot are missed, on the event loop's clock."""
    return slot / _SLOTS


class Deadlines:
    """Deadlines, nearly all of which are met; a missed one is noticed up to 1/64 s late."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._slots: dict[int, dict[Hashable, Callable[[], None]]] = {}
        self._alarm: asyncio.Handle | None = None
        self._next = float("inf")
        """The slot of the alarm; it may have been emptied since."""

    def set(self, seconds: float, owner: Hashable, missed: Callable[[], None]) -> int:
        """Call `missed` after `seconds`, unless `clear` is called before with the returned slot."""
        slot = int((self._loop.time() + seconds) * _SLOTS) + 1
        waiting = self._slots.get(slot)
        if waiting is None:
            waiting = self._slots[slot] = {}
            if slot < self._next:
                self._set_alarm(slot)
        waiting[owner] = missed
        return slot

    def clear(self, slot: int, owner: Hashable) -> None:
        """Forget a deadline."""
        waiting = self._slots.get(slot)
        if waiting is not None:
            waiting.pop(owner, None)
            if not waiting:
                del self._slots[slot]

    def _set_alarm(self, slot: int) -> None:
        if self._alarm is not None:
            self._alarm.cancel()
        self._next = slot
        # In no context: what is missed belongs to many requests.
        self._alarm = self._loop.call_at(moment_of(slot), self._ring, context=Context())

    def _ring(self) -> None:
        self._alarm, self._next = None, float("inf")
        moment = (self._loop.time() + _EARLY) * _SLOTS
        for slot in sorted(slot for slot in self._slots if slot <= moment):
            for missed in self._slots.pop(slot).values():
                self._loop.call_soon(missed)  # one that raises must not silence the others
        if self._slots:
            self._set_alarm(min(self._slots))


class Timers:
    """Scheduled callbacks, none of which is ever taken back."""

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
