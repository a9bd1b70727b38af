"""The body of a quadrotor: six degrees of freedom, motor lag, drag, wind and ground contact."""

from __future__ import annotations

import math

from rcp_mavlink_sim.body import GRAVITY, Body, wrap

__all__ = ["Quad"]

_MOTOR_LAG = 0.04  # s, first-order lag from demand to thrust and torque
_DRAG = 0.12  # 1/s, of the airspeed
_DRAG_SQUARE = 0.008  # 1/m
_THRUST_MOST = 2.3 * GRAVITY  # m/s2
_ANGLE_GAIN, _RATE_GAIN = 6.0, 18.0  # 1/s, angle to rate to angular acceleration
_TURN_MOST = 60.0  # rad/s2, roll and pitch
_YAW_MOST = 8.0  # rad/s2


class Quad(Body):
    """A quadrotor; set its demands in `want_…`, then `step` advances time."""

    def __init__(self) -> None:
        super().__init__()
        self.want_roll = self.want_pitch = self.want_yaw = 0.0
        self.want_thrust = 0.0  # m/s2
        self.thrust = 0.0
        self._torque = [0.0, 0.0, 0.0]

    @property
    def throttle(self) -> float:
        """Fraction of the thrust in use, 0…1."""
        return self.thrust / _THRUST_MOST

    def motors(self) -> tuple[float, float, float, float]:
        """Return each motor's output, 0…1, in ArduPilot's order of a quad X."""
        base = self.throttle
        roll, pitch, yaw = (self._torque[0] / 300, self._torque[1] / 300, self._torque[2] / 120)
        mixed = (
            base - roll + pitch + yaw,
            base + roll - pitch + yaw,
            base + roll + pitch - yaw,
            base - roll - pitch - yaw,
        )
        return tuple(min(1.0, max(0.0, m)) for m in mixed)  # pyright: ignore[reportReturnType]

    def pulses(self, *, armed: bool) -> list[int]:
        """Return the motor outputs, µs."""
        return [round(1000 + 1000 * max(m, 0.1)) if armed else 1000 for m in self.motors()]

    def cut_power(self) -> None:
        """Disable the motors for the next step."""
        self.want_thrust = 0.0

    def step(self, dt: float) -> None:
        """Advance by `dt` seconds, at most 5 ms, or the attitude loop becomes unstable."""
        self._turn(dt)
        blend = dt / (_MOTOR_LAG + dt)
        self.thrust += (min(_THRUST_MOST, max(0.0, self.want_thrust)) - self.thrust) * blend
        self._move(dt)

    def _turn(self, dt: float) -> None:
        if self.landed:
            self.p = self.q = self.r = self.roll = self.pitch = 0.0
            self._torque = [0.0, 0.0, 0.0]
            return
        wanted_yaw = wrap(self.want_yaw - self.yaw)
        errors = (self.want_roll - self.roll, self.want_pitch - self.pitch, wanted_yaw)
        rates = (self.p, self.q, self.r)
        blend = dt / (_MOTOR_LAG + dt)
        for axis, (error, rate) in enumerate(zip(errors, rates, strict=True)):
            most = _YAW_MOST if axis == 2 else _TURN_MOST
            fastest = 1.5 if axis == 2 else 5.0
            gain = 2.5 if axis == 2 else _ANGLE_GAIN
            wanted = min(fastest, max(-fastest, gain * error))
            torque = min(most, max(-most, _RATE_GAIN * (wanted - rate)))
            self._torque[axis] += (torque - self._torque[axis]) * blend
        self.p += self._torque[0] * dt
        self.q += self._torque[1] * dt
        self.r += self._torque[2] * dt
        sin_roll, cos_roll = math.sin(self.roll), math.cos(self.roll)
        turning = self.q * sin_roll + self.r * cos_roll
        self.roll += (self.p + math.tan(self.pitch) * turning) * dt
        self.pitch += (self.q * cos_roll - self.r * sin_roll) * dt
        self.yaw = wrap(self.yaw + turning / math.cos(self.pitch) * dt)

    def _move(self, dt: float) -> None:
        sr, cr = math.sin(self.roll), math.cos(self.roll)
        sp, cp = math.sin(self.pitch), math.cos(self.pitch)
        sy, cy = math.sin(self.yaw), math.cos(self.yaw)
        up = self.thrust
        un, ue = self.vn - self.wind_n, self.ve - self.wind_e
        speed = math.sqrt(un * un + ue * ue + self.vd * self.vd)
        drag = _DRAG + _DRAG_SQUARE * speed
        self.an = -up * (cr * sp * cy + sr * sy) - drag * un
        self.ae = -up * (cr * sp * sy - sr * cy) - drag * ue
        self.ad = GRAVITY - up * cr * cp - drag * self.vd
        if self.landed:
            if self.ad >= 0:
                self.an = self.ae = self.ad = self.vn = self.ve = self.vd = 0.0
                return
            self.landed = False
        self.vn += self.an * dt
        self.ve += self.ae * dt
        self.vd += self.ad * dt
        self.n += self.vn * dt
        self.e += self.ve * dt
        self.d += self.vd * dt
        if self.d >= 0:
            self.impact = self.vd
            self.d = self.vn = self.ve = self.vd = 0.0
            self.landed = True
