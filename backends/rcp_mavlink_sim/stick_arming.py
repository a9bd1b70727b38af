"""Arming by the sticks (`ARMING_RUDDER`): throttle at rest, and yaw held to the right."""

from __future__ import annotations

from typing import Literal

from rcp_mavlink_sim.state import VehicleState

__all__ = ["StickArming"]

_HELD = {"plane": 3.0}  # s, of other vehicles 2
_USUALLY = 2.0
_FULL = 4000 / 4500  # of the way from the middle to the end
_ARMS, _DISARMS = (1, 2), 2  # ARMING_RUDDER


class StickArming:
    """How long the sticks of one vehicle have asked for it."""

    def __init__(self, vehicle: VehicleState) -> None:
        self._vehicle = vehicle
        self._asked: Literal["arm", "disarm"] | None = None
        self._for = 0.0
        self.wanted: Literal["arm", "disarm"] | None = None
        """What the sticks ask for in this step, once each time they are held long enough."""

    def step(self, seconds: float) -> None:
        """Continue."""
        asked, held = self._ask(), _HELD.get(self._vehicle.kind.name, _USUALLY)
        before = self._for if asked == self._asked else 0.0
        self._asked, self._for = asked, before + seconds
        self.wanted = asked if before < held <= self._for else None

    def _ask(self) -> Literal["arm", "disarm"] | None:
        vehicle = self._vehicle
        by_rudder = int(vehicle.params["ARMING_RUDDER"])
        if vehicle.params["SIM_RC_FAIL"] or not self._idle():
            return None
        yaw = self._part("RCMAP_ROLL" if vehicle.kind.drives else "RCMAP_YAW")
        if yaw > _FULL and by_rudder in _ARMS:
            return "arm"
        return "disarm" if yaw < -_FULL and by_rudder == _DISARMS else None

    def _idle(self) -> bool:
        """Return whether the throttle is down, or in the middle of what drives."""
        vehicle = self._vehicle
        channel = int(vehicle.params["RCMAP_THROTTLE"])
        pulse, dead = vehicle.sticks.pulses[channel - 1], vehicle.params[f"RC{channel}_DZ"]
        if vehicle.kind.drives:
            return abs(pulse - vehicle.params[f"RC{channel}_TRIM"]) <= dead
        return pulse <= vehicle.params[f"RC{channel}_MIN"] + dead

    def _part(self, name: str) -> float:
        """Return where a stick is, -1 to 1."""
        params = self._vehicle.params
        channel = int(params[name])
        trim = params[f"RC{channel}_TRIM"]
        away = self._vehicle.sticks.pulses[channel - 1] - trim
        end = params[f"RC{channel}_{'MAX' if away > 0 else 'MIN'}"]
        return away / abs(end - trim) if end != trim else 0.0
