"""Time of measurement: the vehicle's clock counts from boot; TIMESYNC yields the offset."""

from __future__ import annotations

import time
from collections.abc import Callable

from rcp_mavlink.frames import Frame

__all__ = ["Clock"]

_UNIX = 1_000_000_000_000_000  # us: larger values already count from 1970
_SLOWEST = 1_000_000_000  # ns, maximum round trip
_OLDEST = 60_000_000_000  # ns: an older measurement means that the clock is wrong
_WORSE = 1.2  # aging factor of the best round trip, so that drift is followed


class Clock:
    """The offset between a vehicle's clock and ours."""

    def __init__(self, now: Callable[[], int] = time.time_ns) -> None:
        self._now = now
        self._offset: int | None = None
        """Our time (ns) at which its clock was 0."""
        self._best = 0.0
        self._requested = 0

    def request(self) -> int:
        """Return `ts1` for a new request."""
        self._requested = self._now()
        return self._requested

    def on_reply(self, remote: int, requested: int) -> None:
        """Handle the reply to the latest request; the shortest round trip is the most accurate."""
        round_trip = self._now() - requested
        if remote == 0 or requested != self._requested or not 0 <= round_trip <= _SLOWEST:
            return
        self._requested = 0
        if self._best and round_trip > self._best * _WORSE:
            self._best *= _WORSE
            return
        self._best = max(1.0, round_trip)
        self._offset = requested + round_trip // 2 - remote

    def on_system_time(self, unix: int, booted: int) -> None:
        """Handle SYSTEM_TIME (us, ms) of a vehicle that does not answer TIMESYNC."""
        if unix > _UNIX and not self._best:
            self._offset = unix * 1000 - booted * 1_000_000

    def forget(self) -> None:
        """Reset: the vehicle has rebooted."""
        self._offset, self._best, self._requested = None, 0.0, 0

    def of(self, frame: Frame) -> int | None:
        """Return the time of measurement of a message, ns since 1970; None if unknown."""
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
        now = self._now()
        return None if now - at > _OLDEST else min(at, now)
