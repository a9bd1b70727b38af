"""The time on this machine at which a stamped sample was measured, however late it arrives.

Everything here runs in the ROS thread.
"""

from __future__ import annotations

import time
from collections import deque

__all__ = ["Delays", "Ticks"]

_WINDOW = 10.0  # s: clocks drift apart by less than 1 ms in it
_FAR = 3600.0  # s from this machine's time: no clock that is kept, but a simulation's or none
_LATEST = 10.0  # s that a sample may be late; beyond, its clock was set back
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
    """The delays of a topic's samples beyond the least in a while, whatever the robot's clock shows.

    The least difference of arrival and stamp bounds the difference of the clocks: nothing arrives
    before it was measured.
    """

    def __init__(self) -> None:
        self._least: float | None = None
        self._before: float | None = None
        """The least difference of this window and of the one before, s."""
        self._began = 0.0

    def measured(self, stamp: int, arrival: float) -> float:
        """Return the monotonic time of a measurement."""
        moment = stamp / 1e9
        if abs(time.time() - moment) > _FAR:
            return arrival
        apart = arrival - moment
        if self._least is None:
            self._least, self._began = apart, arrival
        elif arrival - self._began > _WINDOW:
            self._before, self._least, self._began = self._least, apart, arrival
        self._least = min(self._least, apart)
        least = self._least if self._before is None else min(self._least, self._before)
        if apart - least > _LATEST:
            self._before, self._least, self._began = None, apart, arrival
            return arrival
        return moment + least
