"""Gripper, winch and parachute as ArduPilot has them, each present if its parameters say so."""

from __future__ import annotations

import math

from rcp_mavlink_sim.state import VehicleState
from rcp_mavlink_sim.wire import mav

__all__ = ["Payloads"]

_LINE = 50.0  # m on the drum
_PWM = 1  # WINCH_TYPE of one without a sensor: ArduPilot counts its line, and knows no ends
_QUICKEST = 1.0  # m/s, WINCH_RATE_MAX
_HEALTHY, _FULLY_RETRACTED, _MOVING, _CLUTCH = 1, 2, 4, 8


class Payloads:
    """The payloads of one vehicle; a reboot forgets their states."""

    def __init__(self, vehicle: VehicleState) -> None:
        self._vehicle = vehicle
        self.gripped = False
        self.line = 0.0
        """Length of the line that is out, m."""
        self._line_target: float | None = None
        self._line_rate = 0.0
        self.relaxed = False
        """Whether the drum turns freely."""
        self.released = False
        """Whether the parachute is out."""
        self.parachute_enabled = True

    # Gripper

    def grip(self, action: float) -> bool:
        """Open (0) or close (1) it; return whether there is one that can."""
        if not self._vehicle.params["GRIP_ENABLE"] or action not in (0, 1):
            return False
        self.gripped = action == mav.GRIPPER_ACTION_GRAB
        self._vehicle.send_text(
            6, "Gripper load grabbed" if self.gripped else "Gripper load releasing"
        )
        return True

    # Winch

    def wind(self, action: float, length: float, rate: float) -> bool:
        """Relax it (0), wind by a length (1) or at a rate (2); return whether it can."""
        if not self._vehicle.params["WINCH_TYPE"] or action not in (0, 1, 2):
            return False
        if not (math.isfinite(length) and math.isfinite(rate)):
            return False
        self.relaxed = action == mav.WINCH_RELAXED
        self._line_target, self._line_rate = None, 0.0
        if action == mav.WINCH_RELATIVE_LENGTH_CONTROL:
            least, most = self._ends
            self._line_target = min(most, max(least, self.line + length))
            self._line_rate = min(_QUICKEST, abs(rate) or _QUICKEST)
        elif action == mav.WINCH_RATE_CONTROL:
            self._line_target = self._ends[rate > 0] if rate else None
            self._line_rate = min(_QUICKEST, abs(rate))
        return True

    @property
    def _ends(self) -> tuple[float, float]:
        """Between which lengths the line can be, m."""
        return (-math.inf, math.inf) if self._by_pulses else (0.0, _LINE)

    @property
    def _by_pulses(self) -> bool:
        return self._vehicle.params["WINCH_TYPE"] == _PWM

    @property
    def line_speed(self) -> float:
        """How fast the line goes out, m/s."""
        if self._line_target is None or self._line_target == self.line:
            return 0.0
        return math.copysign(self._line_rate, self._line_target - self.line)

    def winch_status(self) -> int:
        """Return the MAV_WINCH_STATUS_FLAG bits; one driven by pulses sets no more than the first."""
        if self._by_pulses:
            return _HEALTHY
        flags = _HEALTHY | (_CLUTCH if self.relaxed else 0)
        flags |= _FULLY_RETRACTED if self.line == 0 else 0
        return flags | (_MOVING if self.line_speed else 0)

    # Parachute

    def parachute(self, action: float) -> bool:
        """Disable (0), enable (1) or release (2) it; return whether it can."""
        vehicle = self._vehicle
        if not vehicle.params["CHUTE_ENABLED"] or action not in (0, 1, 2):
            return False
        if action != mav.PARACHUTE_RELEASE:
            self.parachute_enabled = action == mav.PARACHUTE_ENABLE
            return True
        if not self.parachute_enabled:
            return False
        if not vehicle.armed or vehicle.body.landed:
            vehicle.send_text(4, "Parachute: Landed")
            return False
        if -vehicle.body.d < vehicle.params["CHUTE_ALT_MIN"]:
            vehicle.send_text(4, "Parachute: Too low")
            return False
        vehicle.send_text(4, "Parachute: Released")
        self.released = True
        vehicle.armed = vehicle.pilot.spinning = False
        return True

    def step(self, seconds: float) -> None:
        """Continue to wind."""
        speed = self.line_speed
        if speed and self._line_target is not None:
            way, left = speed * seconds, self._line_target - self.line
            self.line = self._line_target if abs(way) >= abs(left) else self.line + way
