"""Checks that a vehicle keeps the requested speed and heading."""

from __future__ import annotations

import math
import time

from rcp_mavlink.vehicle import Vehicle

__all__ = ["Pace"]

_OVER, _MARGIN = 1.25, 0.7  # tolerance: a factor of the requested speed, and m/s above it
_SLOWING, _FIRST = 1.0, 2.0  # m/s2, minimum deceleration, and s allowed in any case
_TOO_LONG = 1.5  # s of overspeed allowed, as in a gust
_ALIGNED = math.radians(6)
_TURNING = 20.0  # s allowed for turning at the target
_NO_HEADING = 65535


class Pace:
    """The speed and heading during one flight, by GLOBAL_POSITION_INT."""

    def __init__(self, vehicle: Vehicle, speed: float | None, yaw: float | None) -> None:
        self._vehicle, self._yaw = vehicle, yaw
        self._fast_since: float | None = None
        self.request(speed)
        self._there_since: float | None = None
        self.fastest = 0.0
        """Maximum ground speed, m/s."""
        self.heading: float | None = None
        """The present heading, rad."""
        self.fault: str | None = None
        """What deviates from the request."""

    def request(self, speed: float | None) -> None:
        """Expect another speed, m/s, after the time to slow down."""
        # Of a plane it is the airspeed, to which the wind is added.
        self._speed = None if self._vehicle.family.circles else speed
        self._settled = time.monotonic() + _FIRST + self._measured()[0] / _SLOWING
        self._fast_since = None

    def update(self, *, there: bool) -> bool:
        """Take the latest measurement; return whether it is there, with the requested heading."""
        now = time.monotonic()
        speed, self.heading = self._measured()
        self.fastest = max(self.fastest, speed)
        self._watch_speed(speed, now)
        if not there:
            self._there_since = None
            return False
        if self._there_since is None:
            self._there_since = now
        return self._aligned(now) and self.fault is None

    def _measured(self) -> tuple[float, float | None]:
        frame = self._vehicle.latest.get("GLOBAL_POSITION_INT")
        if frame is None:
            return 0.0, None
        f = frame.fields()
        heading = None if f["hdg"] == _NO_HEADING else math.radians(f["hdg"] / 100)
        return math.hypot(f["vx"], f["vy"]) / 100, heading

    def _watch_speed(self, speed: float, now: float) -> None:
        limit = self._speed
        if limit is None or now < self._settled or speed <= max(limit * _OVER, limit + _MARGIN):
            self._fast_since = None
            return
        if self._fast_since is None:
            self._fast_since = now
        if now - self._fast_since > _TOO_LONG:
            self.fault = f"{limit:g} m/s requested, but it moves at {speed:.1f} m/s"

    def _aligned(self, now: float) -> bool:
        """Return whether it has the requested heading, or none was requested."""
        if self._yaw is None:
            return True
        if self.heading is not None:
            off = math.remainder(self.heading - self._yaw, math.tau)
            if abs(off) <= _ALIGNED:
                return True
        if self._there_since is not None and now - self._there_since > _TURNING:
            heading = (
                "reports no heading"
                if self.heading is None
                else f"its heading is {self.heading:.2f} rad"
            )
            self.fault = f"it is at the target, but {heading}, not {self._yaw:.2f} rad"
        return False
