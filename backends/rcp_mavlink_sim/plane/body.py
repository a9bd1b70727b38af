"""A fixed-wing as a banking point mass: lift turns it, power and drag set its energy."""

from __future__ import annotations

import math

from rcp_mavlink_sim.body import GRAVITY, Body, wrap
from rcp_mavlink_sim.pilot import clip

__all__ = ["Wing"]

_STALL = 11.0  # m/s, in level flight
_POWER = 6.0  # m/s2 of thrust at full power
_PARASITIC, _INDUCED = 0.0022, 210.0  # drag coefficients: 1/m, m3/s4
_ENGINE_LAG, _ROLL_LAG, _PITCH_LAG = 0.4, 0.35, 0.6  # s
_ROLL_RATE, _PITCH_RATE = 1.5, 0.6  # rad/s
_STALLED = -0.25  # rad, path angle
_ROLLING, _BRAKES = 0.3, 2.0  # m/s2 on the ground
_ROTATE = 14.0  # m/s airspeed
_TURN_ON_FLOOR = 0.5  # rad/s


class Wing(Body):
    """A plane; `want_bank` and `want_path` are rad, `want_power` 0…1."""

    def __init__(self) -> None:
        super().__init__()
        self.want_bank = self.want_path = self.want_power = 0.0
        self.airspeed = 0.0  # m/s
        self._power = 0.0
        self._path = 0.0
        """Climb angle through the air, rad."""

    @property
    def throttle(self) -> float:
        """Fraction of the power in use, 0…1."""
        return self._power

    @property
    def drag(self) -> float:
        """Present drag, m/s2."""
        load = 1 / max(0.3, math.cos(self.roll))
        v2 = max(25.0, self.airspeed**2)
        return _PARASITIC * v2 + _INDUCED * load * load / v2

    def power_for(self, acceleration: float) -> float:
        """Return the power for an acceleration (m/s2) along its path."""
        return (self.drag + GRAVITY * math.sin(self._path) + acceleration) / _POWER

    def pulses(self, *, armed: bool) -> list[int]:
        """Return aileron, elevator, throttle and rudder, µs."""
        power = round(1000 + 1000 * self._power) if armed else 1000
        bank, path = self.want_bank - self.roll, self.want_path - self._path
        return [round(1500 + 400 * clip(bank, 1)), round(1500 + 400 * clip(path, 1)), power, 1500]

    def cut_power(self) -> None:
        """Disable the motor for the next step."""
        self.want_power = 0.0

    def step(self, dt: float) -> None:
        """Advance by `dt` seconds."""
        wanted = min(1.0, max(0.0, self.want_power))
        self._power += (wanted - self._power) * dt / (_ENGINE_LAG + dt)
        before = self.vn, self.ve, self.vd
        if self.landed:
            self._roll_along(dt)
        else:
            self._fly(dt)
        self.an, self.ae, self.ad = (
            (now - was) / dt for now, was in zip((self.vn, self.ve, self.vd), before, strict=True)
        )
        self.n += self.vn * dt
        self.e += self.ve * dt
        self.d += self.vd * dt
        if self.d >= 0 and not self.landed:
            self.impact = self.vd
            self.d = self.vd = self._path = self.roll = self.pitch = self.p = self.q = 0.0
            self.landed = True

    def _roll_along(self, dt: float) -> None:
        s, c = math.sin(self.yaw), math.cos(self.yaw)
        along = self.vn * c + self.ve * s
        brakes = _BRAKES if self.want_power <= 0 else _ROLLING
        along += (self._power * _POWER - _PARASITIC * along * along) * dt
        along = max(0.0, along - brakes * dt)
        self.airspeed = along - self.wind_n * c - self.wind_e * s
        self.r = clip(self.want_bank, _TURN_ON_FLOOR) if along > 1 else 0.0
        self.yaw = wrap(self.yaw + self.r * dt)
        self.vn, self.ve, self.vd = along * c, along * s, 0.0
        if self.airspeed > _ROTATE and self.want_path > 0:
            self.landed = False
            self.d, self._path = -0.01, 0.02

    def _fly(self, dt: float) -> None:
        bank = clip((self.want_bank - self.roll) / _ROLL_LAG, _ROLL_RATE)
        self.roll += bank * dt
        stalled = self.airspeed < _STALL / math.sqrt(max(0.3, math.cos(self.roll)))
        wanted = min(self.want_path, _STALLED) if stalled else self.want_path
        rise = clip((wanted - self._path) / _PITCH_LAG, _PITCH_RATE)
        self._path += rise * dt
        gained = self._power * _POWER - self.drag - GRAVITY * math.sin(self._path)
        self.airspeed = max(3.0, self.airspeed + gained * dt)
        turn = GRAVITY * math.tan(self.roll) / self.airspeed
        self.yaw = wrap(self.yaw + turn * dt)
        self.pitch = self._path + 0.03 + 0.05 * (_STALL / self.airspeed) ** 2
        self.p, self.q, self.r = bank, rise + turn * math.sin(self.roll), turn * math.cos(self.roll)
        level = self.airspeed * math.cos(self._path)
        self.vn = level * math.cos(self.yaw) + self.wind_n
        self.ve = level * math.sin(self.yaw) + self.wind_e
        self.vd = -self.airspeed * math.sin(self._path)
