"""The time on this machine at which a stamped sample was measured, however late it arrives.

Everything here runs in the ROS thread.
"""

from __future__ import annotations

import time
from collections import deque

from rcp_links import Lateness

__all__ = ["Delays", "Ticks"]

_FAR = 3600.0  # s from this machine's time: no clock that is kept, but a simulation's or none
_TICK = 0.005  # s between two ticks that are kept
_TICKS = 2000


class Ticks:
    """When the times of `/clock` arrived: it may run at any rate, pause and begin again."""

    def __init__(self) -> None:
        self._known: deque[tuple[int, float]] = deque(maxlen=_TICKS)
        """Times in ns, and the monotonic times of their arrival."""

    def add(self, tick: int) -> None:
        """Record a time that has just arrived."""
        now = time.monotonic()
        if self._known and tick < self._known[-1][0]:
            self._known.clear()
        if not self._known or now - self._known[-1][1] >= _TICK:
            self._known.append((tick, now))

    def measured(self, stamp: int, arrival: float) -> float:
        """Return the arrival of the first time not before the stamp."""
        found = arrival
        for tick, at in reversed(self._known):
            if tick < stamp:
                break
            found = at
        return found


class Delays:
    """The times of a topic's samples by their stamps, whatever the robot's clock shows."""

    def __init__(self) -> None:
        self._lateness = Lateness()

    def measured(self, stamp: int, arrival: float) -> float:
        """Return the monotonic time of a measurement."""
        moment = stamp / 1e9
        if abs(time.time() - moment) > _FAR:
            return arrival
        return arrival - self._lateness.of(arrival - moment, arrival)
