"""When a vehicle measured what it says: its clock counts from its start, TIMESYNC tells from when."""

from __future__ import annotations

import time

from rcp_mavlink.frames import Frame

__all__ = ["Clock"]

_UNIX = 1_000_000_000_000_000  # us: what is more than this counts from 1970 by itself
_SLOWEST = 1_000_000_000  # ns that an answer may take
_OLDEST = 60_000_000_000  # ns: what seems older was measured by a clock that is wrong
_WORSE = 1.2  # by which the best answer loses its weight each time, so that drift is followed


class Clock:
    """The clock of one vehicle beside ours."""

    def __init__(self) -> None:
        self._offset: int | None = None
        """Our time (ns) when its clock was 0."""
        self._best = 0.0
        self._requested = 0

    def request(self) -> int:
        """Return what `ts1` of a request is."""
        self._requested = time.time_ns()
        return self._requested

    def on_reply(self, theirs: int, requested: int) -> None:
        """Take an answer to the latest request: what took the shortest way is the nearest."""
        took = time.time_ns() - requested
        if theirs == 0 or requested != self._requested or not 0 <= took <= _SLOWEST:
            return
        self._requested = 0
        if self._best and took > self._best * _WORSE:
            self._best *= _WORSE
            return
        self._best = max(1.0, took)
        self._offset = requested + took // 2 - theirs

    def on_system_time(self, unix: int, booted: int) -> None:
        """Take SYSTEM_TIME (us, ms) of a vehicle that answers no TIMESYNC."""
        if unix > _UNIX and not self._best:
            self._offset = unix * 1000 - booted * 1_000_000

    def forget(self) -> None:
        """Know nothing of it: it has begun anew."""
        self._offset, self._best, self._requested = None, 0.0, 0

    def of(self, frame: Frame) -> int | None:
        """Return when a message was measured, ns since 1970; None: that is not known."""
        stamp = frame.definition.stamp
        if stamp is None:
            return None
        place, size, scale = stamp
        if size == 4 and self._offset is None:
            return None
        ticks = int.from_bytes(frame.payload[place : place + size], "little")
        if size == 8 and ticks > _UNIX:
            at = ticks * 1000
        elif self._offset is not None and ticks:
            at = self._offset + ticks * scale
        else:
            return None
        now = time.time_ns()
        return None if now - at > _OLDEST else min(at, now)
