"""Time that several motors share, which a late host only slows down."""

from __future__ import annotations

import time
from collections.abc import Callable

__all__ = ["Pace"]


class Pace:
    """Goes on once in each control cycle, by `late` s at most; a member asks in every cycle.

    The next cycle begins when a member asks again. So all members are told the same time wherever
    the host stood still, and one that asks no more does not hold up the others.
    """

    def __init__(self, late: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._late, self._clock = late, clock
        self._asked: set[int] = set()
        self._last = float("-inf")

    def advance(self, member: int) -> float:
        """Return by how much time goes on as a member asks, s; nothing in the first cycle."""
        if not self._asked:
            self._last = self._clock()
        if member not in self._asked:
            self._asked.add(member)
            return 0.0
        now = self._clock()
        dt, self._last = min(now - self._last, self._late), now
        self._asked = {member}
        return dt

    def restart(self) -> None:
        """Forget the cycles so far: what follows begins at rest, whenever its members ask."""
        self._asked.clear()
