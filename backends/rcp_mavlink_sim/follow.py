"""What a copter follows in its mode FOLLOW (`AP_Follow`): the estimate of a target, by its messages."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from rcp_mavlink_sim.parameters import Parameters

__all__ = ["Estimate", "Leader"]

_LATE = 3.0  # s after which a target is lost
_FORGOTTEN = 10.0  # s after which another system may be followed
_POSITION, _VELOCITY, _ATTITUDE = 1, 2, 8
_RELATIVE = 1  # FOLL_ALT_TYPE
_TO_ITS_HEADING = 1  # FOLL_OFS_TYPE


class Estimate(msgspec.Struct, frozen=True):
    """Where the target is now."""

    lat: float
    lon: float
    altitude: float
    """Above home, m."""
    velocity: tuple[float, float, float]
    """North, east, down."""


class Leader:
    """The target of one vehicle, by FOLLOW_TARGET, or by GLOBAL_POSITION_INT while there is none of those."""

    def __init__(self, params: Parameters) -> None:
        self._params = params
        self._automatic = False
        """Whether FOLL_SYSID is that of the first system that was heard."""
        self._at = -math.inf
        self._estimate: Estimate | None = None
        self._heading: float | None = None
        self._by_follow_target = False
        self._offset: tuple[float, float, float] | None = None
        """North, east and down of the target, kept because the parameters have none."""

    def take(self, message: Any, now: float, home_altitude: float) -> None:
        """Handle a message of another system."""
        if not self._params["FOLL_ENABLE"]:
            return
        if now - self._at > _FORGOTTEN:
            self._by_follow_target = False
            self.release()
        wanted, system = int(self._params["FOLL_SYSID"]), message.get_srcSystem()
        if system != (wanted or system) or message.lat == message.lon == 0:
            return
        if message.get_type() == "FOLLOW_TARGET":
            if not message.est_capabilities & _POSITION:
                return
            self._by_follow_target = True
            known = message.est_capabilities & _VELOCITY
            n, e, d = message.vel if known else (0.0, 0.0, 0.0)
            altitude = self._height(message.alt - home_altitude)
            self._heading = self._facing(message, n, e)
        elif self._by_follow_target:
            return
        else:
            n, e, d = message.vx / 100, message.vy / 100, message.vz / 100
            relative = self._params["FOLL_ALT_TYPE"] == _RELATIVE
            altitude = message.relative_alt / 1e3 if relative else message.alt / 1e3 - home_altitude
            self._heading = None if message.hdg == 65535 else math.radians(message.hdg / 100)
        if not all(map(math.isfinite, (n, e, d, altitude))):
            return
        if not wanted:
            self._params.set("FOLL_SYSID", system)
            self._automatic = True
        self._at = now
        self._estimate = Estimate(message.lat / 1e7, message.lon / 1e7, altitude, (n, e, d))

    def _height(self, above_home: float) -> float:
        """Return the height from which the offset counts."""
        return above_home

    def _facing(self, message: Any, north: float, east: float) -> float | None:
        """Return where a target faces, by a FOLLOW_TARGET with its velocity to the north and east."""
        if not message.est_capabilities & _ATTITUDE:
            return self._heading
        w, x, y, z = message.attitude_q
        return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    def estimate(self, now: float) -> tuple[Estimate, float] | None:
        """Return the latest position with its age, s; None if the target is lost."""
        age = now - self._at
        return None if self._estimate is None or age > _LATE else (self._estimate, age)

    def release(self) -> None:
        """Follow no system by itself any more, as after a reboot: it did not store which."""
        if self._automatic:
            self._params.set("FOLL_SYSID", 0)

    def forget_offset(self) -> None:
        """Have the next offset be the present distance, unless the parameters have one."""
        self._offset = None

    def offset(self, present: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return where to stay, north, east and down of the target, m; `present` is where it is now."""
        p = self._params
        x, y, z = p["FOLL_OFS_X"], p["FOLL_OFS_Y"], p["FOLL_OFS_Z"]
        if x == y == z == 0:
            self._offset = self._offset or present
            return self._offset
        if p["FOLL_OFS_TYPE"] == _TO_ITS_HEADING and self._heading is not None:
            s, c = math.sin(self._heading), math.cos(self._heading)
            x, y = x * c - y * s, x * s + y * c
        return x, y, z
