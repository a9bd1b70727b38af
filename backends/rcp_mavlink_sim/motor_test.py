"""DO_MOTOR_TEST of a copter: one motor turns for a while, and the vehicle counts as armed meanwhile."""

from __future__ import annotations

from rcp_mavlink_sim.state import VehicleState
from rcp_mavlink_sim.wire import mav

__all__ = ["MotorTest"]

_MOTORS = 4
_LONGEST = 600.0  # s, MOTOR_TEST_TIMEOUT_SEC


class MotorTest:
    """The test of one motor; the times are real."""

    def __init__(self, vehicle: VehicleState) -> None:
        self._vehicle = vehicle
        self.motor = 0
        """The motor that turns, from 1; 0 if none."""
        self._pulse = 0
        self.until = 0.0
        """When it stops, by the vehicle's real time."""

    def begin(self, motor: float, kind: float, throttle: float, seconds: float) -> bool:
        """Turn a motor by percent (`kind` 0) or pulse width (1); return whether it may be."""
        vehicle = self._vehicle
        if not self.motor and (vehicle.armed or not vehicle.body.landed):
            vehicle.send_text(2, "Motor Test: vehicle not landed")
            return False
        pulse = self._width(kind, throttle)
        if pulse is None or not (1 <= motor <= _MOTORS and seconds >= 0):
            return False
        if not self.motor:
            vehicle.send_text(6, "starting motor tests")
        self.motor, self._pulse = int(motor), pulse
        self.until = vehicle.wall + min(seconds, _LONGEST)
        return True

    def _width(self, kind: float, throttle: float) -> int | None:
        p = self._vehicle.params
        least, most = p["MOT_PWM_MIN"], p["MOT_PWM_MAX"]
        if kind == mav.MOTOR_TEST_THROTTLE_PERCENT and 0 <= throttle <= 100:
            return round(least + (most - least) * throttle / 100)
        if kind == mav.MOTOR_TEST_THROTTLE_PWM and 800 <= throttle <= 2200:
            return round(throttle)
        return None

    def end(self) -> None:
        """Stop the motor."""
        if self.motor:
            self.motor = 0
            self._vehicle.send_text(6, "finished motor test")

    def check(self) -> None:
        """Stop the motor when its time is over."""
        if self.motor and self._vehicle.wall >= self.until:
            self.end()

    def pulses(self) -> dict[int, int]:
        """Return the width that the tested output has, µs, by its number."""
        return {self.motor: self._pulse} if self.motor else {}
