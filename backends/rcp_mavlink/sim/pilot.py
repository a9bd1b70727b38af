"""The controller: from a place, a velocity or an attitude wanted to lean angles and thrust."""

from __future__ import annotations

import math

from rcp_mavlink.sim.body import GRAVITY, Body

__all__ = ["Limits", "Pilot"]

_LEAN_MOST = 0.52  # rad
_PLACE_GAIN = 1.0  # 1/s
_SPEED_GAIN = 2.5  # 1/s
_CLIMB_GAIN = 5.0  # 1/s


class Limits:
    """How fast it goes, from the parameters of the vehicle."""

    def __init__(self) -> None:
        self.speed = 10.0  # m/s
        self.up = 2.5  # m/s
        self.down = 1.5  # m/s
        self.acceleration = 2.5  # m/s2
        self.climb_acceleration = 1.5  # m/s2


class Pilot:
    """Flies a `Body`; north, east and down are each led by a place or by a velocity."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self.limits = Limits()
        self.place: tuple[float, float] | None = (0.0, 0.0)
        """North and east to be at, m; None follows `velocity`."""
        self.velocity = (0.0, 0.0)
        """North and east, m/s; with a place it is where that place moves to."""
        self.depth: float | None = None
        """Down to be at, m; None follows `sinking`."""
        self.sinking = 0.0  # m/s, down
        self.yaw = 0.0
        self.yaw_rate = 0.0  # rad/s, lets `yaw` run
        self.attitude: tuple[float, float, float] | None = None
        """Roll, pitch (rad) and thrust (0…1, half is hovering) that rule instead of all else."""
        self.spinning = False
        self._vn = self._ve = self._vd = 0.0

    def hold(self) -> None:
        """Stay where it would come to rest if it braked now."""
        body, limits = self.body, self.limits
        speed = math.hypot(body.vn, body.ve)
        way = speed / (2 * limits.acceleration) + 0.4
        self.place = (body.n + body.vn * way, body.e + body.ve * way)
        self.velocity = (0.0, 0.0)
        self.depth = body.d + body.vd * 0.5
        self.sinking = self.yaw_rate = 0.0
        self.attitude = None

    def at_place(self, tolerance: float) -> bool:
        """Tell whether it is where it should be, within `tolerance` m."""
        body = self.body
        if self.place is None or self.depth is None:
            return False
        n, e = self.place
        return math.dist((body.n, body.e, body.d), (n, e, self.depth)) <= tolerance

    def reset(self) -> None:
        """Begin from rest, as after arming."""
        self._vn = self._ve = self._vd = 0.0
        self.yaw, self.yaw_rate, self.attitude = self.body.yaw, 0.0, None

    def step(self, dt: float) -> None:
        """Say what the motors should do for the next `dt` seconds."""
        body = self.body
        if not self.spinning:
            body.want_thrust = 0.0
            return
        self.yaw += self.yaw_rate * dt
        body.want_yaw = self.yaw
        if self.attitude is not None:
            body.want_roll, body.want_pitch, thrust = self.attitude
            body.want_thrust = 2 * thrust * GRAVITY
            return
        self._level(dt)
        self._climb(dt)

    def _level(self, dt: float) -> None:
        body, limits = self.body, self.limits
        if self.place is None:
            vn, ve = self.velocity
        else:
            dn, de = self.place[0] - body.n, self.place[1] - body.e
            way = math.hypot(dn, de)
            pace = _pace(way, limits.speed, limits.acceleration)
            part = pace / way if way > 1e-6 else 0.0
            vn, ve = dn * part + self.velocity[0], de * part + self.velocity[1]
        self._vn, self._ve = _toward((self._vn, self._ve), (vn, ve), limits.acceleration * 1.5 * dt)
        an = _SPEED_GAIN * (self._vn - body.vn) + 0.12 * (body.vn - body.wind_n)
        ae = _SPEED_GAIN * (self._ve - body.ve) + 0.12 * (body.ve - body.wind_e)
        sy, cy = math.sin(body.yaw), math.cos(body.yaw)
        forward, right = an * cy + ae * sy, ae * cy - an * sy
        body.want_pitch = _clip(math.atan2(-forward, GRAVITY), _LEAN_MOST)
        body.want_roll = _clip(math.atan2(right, GRAVITY), _LEAN_MOST)

    def _climb(self, dt: float) -> None:
        body, limits = self.body, self.limits
        if self.depth is None:
            wanted = self.sinking
        else:
            left = self.depth - body.d
            fastest = limits.down if left > 0 else limits.up
            pace = _pace(abs(left), fastest, limits.climb_acceleration)
            wanted = math.copysign(pace, left)
        change = _clip(wanted - self._vd, limits.climb_acceleration * 1.5 * dt)
        self._vd += change
        sink = _clip(_CLIMB_GAIN * (self._vd - body.vd), 6.0)
        upright = max(0.5, math.cos(body.roll) * math.cos(body.pitch))
        body.want_thrust = (GRAVITY - sink) / upright


def _pace(way: float, fastest: float, acceleration: float) -> float:
    """Return the speed at which `way` m are still enough to brake in."""
    linear = acceleration / (_PLACE_GAIN * _PLACE_GAIN)
    if way <= linear:
        return min(fastest, _PLACE_GAIN * way)
    return min(fastest, math.sqrt(2 * acceleration * (way - linear / 2)))


def _toward(
    now: tuple[float, float], wanted: tuple[float, float], most: float
) -> tuple[float, float]:
    dn, de = wanted[0] - now[0], wanted[1] - now[1]
    way = math.hypot(dn, de)
    if way <= most:
        return wanted
    return now[0] + dn / way * most, now[1] + de / way * most


def _clip(value: float, most: float) -> float:
    return min(most, max(-most, value))
