"""The controller of a quadrotor: position, velocity or attitude to lean angles and thrust."""

from __future__ import annotations

import math

from rcp_mavlink_sim.body import GRAVITY
from rcp_mavlink_sim.copter.body import Quad
from rcp_mavlink_sim.pilot import Pilot, clip, pace

__all__ = ["QuadPilot"]

_LEAN_MOST = 0.52  # rad
_PLACE_GAIN = 1.0  # 1/s
_SPEED_GAIN = 2.5  # 1/s
_CLIMB_GAIN = 5.0  # 1/s
_FACES_TRAVEL_FROM = 0.05  # of the maximum speed, above which it turns


class QuadPilot(Pilot):
    """Flies a `Quad`."""

    body: Quad

    def __init__(self, body: Quad) -> None:
        super().__init__(body)
        self._vn = self._ve = self._vd = 0.0

    def reset(self) -> None:
        """Start from rest, as after arming."""
        super().reset()
        self._vn = self._ve = self._vd = 0.0

    def step(self, dt: float) -> None:
        """Set the demands of the body for the next `dt` seconds."""
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
        if self.lean is None:
            self._level(dt)
        else:
            body.want_roll, body.want_pitch = self.lean
        self._climb(dt)

    def _level(self, dt: float) -> None:
        body, limits = self.body, self.limits
        if self.place is None:
            vn, ve = self.velocity
        else:
            dn, de = self.place[0] - body.n, self.place[1] - body.e
            distance = math.hypot(dn, de)
            quick = pace(distance, limits.speed, limits.acceleration, _PLACE_GAIN)
            part = quick / distance if distance > 1e-6 else 0.0
            vn, ve = dn * part + self.velocity[0], de * part + self.velocity[1]
        if self.most is not None and math.hypot(vn, ve) > self.most:
            part = self.most / math.hypot(vn, ve)
            vn, ve = vn * part, ve * part
        if self.faces_travel and math.hypot(vn, ve) > _FACES_TRAVEL_FROM * limits.speed:
            self.yaw = math.atan2(ve, vn)
        self._vn, self._ve = _toward((self._vn, self._ve), (vn, ve), limits.acceleration * 1.5 * dt)
        an = _SPEED_GAIN * (self._vn - body.vn) + 0.12 * (body.vn - body.wind_n)
        ae = _SPEED_GAIN * (self._ve - body.ve) + 0.12 * (body.ve - body.wind_e)
        sy, cy = math.sin(body.yaw), math.cos(body.yaw)
        forward, right = an * cy + ae * sy, ae * cy - an * sy
        body.want_pitch = clip(math.atan2(-forward, GRAVITY), _LEAN_MOST)
        body.want_roll = clip(math.atan2(right, GRAVITY), _LEAN_MOST)

    def _climb(self, dt: float) -> None:
        body, limits = self.body, self.limits
        if self.depth is None:
            wanted = self.sinking
        else:
            left = self.depth - body.d
            fastest = limits.down if left > 0 else limits.up
            quick = pace(abs(left), fastest, limits.climb_acceleration, _PLACE_GAIN)
            wanted = math.copysign(quick, left)
        change = clip(wanted - self._vd, limits.climb_acceleration * 1.5 * dt)
        self._vd += change
        sink = clip(_CLIMB_GAIN * (self._vd - body.vd), 6.0)
        upright = max(0.5, math.cos(body.roll) * math.cos(body.pitch))
        body.want_thrust = (GRAVITY - sink) / upright


def _toward(
    now: tuple[float, float], wanted: tuple[float, float], most: float
) -> tuple[float, float]:
    dn, de = wanted[0] - now[0], wanted[1] - now[1]
    distance = math.hypot(dn, de)
    if distance <= most:
        return wanted
    return now[0] + dn / distance * most, now[1] + de / distance * most
