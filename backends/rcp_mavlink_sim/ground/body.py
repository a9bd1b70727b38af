"""A body on the surface: a motor and a rudder or steered wheels, with lag."""

from __future__ import annotations

import math

from rcp_mavlink_sim.body import GRAVITY, Body, wrap

__all__ = ["Hull"]

_GRIP = 0.8  # fraction of gravity, lateral grip of wheels
_SLIDE = 0.6  # s until a boat stops drifting sideways
_MOTOR_LAG, _BOAT_LAG = 0.25, 1.2  # s
_TURN_LAG, _BOAT_TURN_LAG = 0.1, 0.5  # s
_LEEWAY = 0.04  # fraction of the wind, drift of a boat
_FASTEST = 6.0  # m/s at full power


class Hull(Body):
    """A rover or a boat; it cannot leave the surface."""

    def __init__(self, *, floats: bool) -> None:
        super().__init__()
        self._floats = floats
        self.want_speed = self.want_turn = 0.0
        """Forward, m/s, and clockwise, rad/s."""
        self._forward = self._right = 0.0  # m/s through the water

    @property
    def speed(self) -> float:
        """Forward speed through the water or over the ground, m/s."""
        return self._forward

    @property
    def throttle(self) -> float:
        """Fraction of the power in use, 0…1."""
        return min(1.0, abs(self.want_speed) / _FASTEST)

    def pulses(self, *, armed: bool) -> list[int]:
        """Return steering and throttle, µs."""
        if not armed:
            return [1500, 0, 1500]
        turn = max(-1.0, min(1.0, self.want_turn))
        drive = max(-1.0, min(1.0, self.want_speed / _FASTEST))
        return [round(1500 + 400 * turn), 0, round(1500 + 400 * drive)]

    def cut_power(self) -> None:
        """Disable the motors for the next step."""
        self.want_speed = 0.0

    def step(self, dt: float) -> None:
        """Advance by `dt` seconds."""
        motor, rudder = (_BOAT_LAG, _BOAT_TURN_LAG) if self._floats else (_MOTOR_LAG, _TURN_LAG)
        self._forward += (self.want_speed - self._forward) * dt / (motor + dt)
        turn = self.want_turn
        if self._floats:
            self._right -= (self._right + self._forward * self.r * _SLIDE) * dt / (_SLIDE + dt)
        elif abs(self._forward * turn) > _GRIP * GRAVITY:  # it slides instead of turning
            turn = math.copysign(_GRIP * GRAVITY / abs(self._forward), turn)
        self.r += (turn - self.r) * dt / (rudder + dt)
        self.yaw = wrap(self.yaw + self.r * dt)
        s, c = math.sin(self.yaw), math.cos(self.yaw)
        leeway = _LEEWAY if self._floats else 0.0
        vn = self._forward * c - self._right * s + self.wind_n * leeway
        ve = self._forward * s + self._right * c + self.wind_e * leeway
        self.an, self.ae = (vn - self.vn) / dt, (ve - self.ve) / dt
        self.vn, self.ve = vn, ve
        self.n += vn * dt
        self.e += ve * dt
