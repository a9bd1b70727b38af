"""Compass and accelerometer calibration as ArduPilot does them; somebody has to turn the vehicle."""

from __future__ import annotations

import math
from typing import Any

from rcp_mavlink_sim.state import VehicleState
from rcp_mavlink_sim.wire import mav

__all__ = ["Calibrations"]

_COMPASSES = 2
_ALL = (1 << _COMPASSES) - 1
_TURNING = 10.0  # simulated seconds of turning that a compass needs
_FITNESS, _OFFSETS = 6.2, (12.0, -7.0, 31.0)
_POSITIONS = 6
_SUCCESS, _FAILED = 16777215.0, 16777216.0
_REPEAT = 1.0  # simulated seconds after which a position is asked for again
_NAMES = ("level", "on its LEFT side", "on its RIGHT side", "nose DOWN", "nose UP", "on its BACK")


class Calibrations:
    """The calibrations of one vehicle.

    `SIM_TURNED` 1 is somebody who turns it all around, `SIM_POSTURE` the position it is held in
    (1 level, 2 and 3 on its left and right side, 4 and 5 nose down and up, 6 on its back).
    """

    def __init__(self, vehicle: VehicleState) -> None:
        self._vehicle = vehicle
        self.mask = 0
        """The compasses in calibration, as bits."""
        self._done = 0.0
        self.position = 0
        """The position of the accelerometers that is waited for; 0 if none."""
        self._wrong = False
        self._repeat = 0.0
        self.radio = False
        """Whether a ground station calibrates the remote control, so that it refuses to arm."""

    # Compass

    def start_compass(self, mask: float) -> bool:
        """Start; return whether it may be."""
        vehicle = self._vehicle
        if vehicle.armed:
            vehicle.send_text(5, "Disarm to allow compass calibration")
            return False
        if not math.isfinite(mask) or int(mask) & ~_ALL:
            return False
        self.mask, self._done = int(mask) or _ALL, 0.0
        return True

    def cancel_compass(self) -> None:
        """End it without a result."""
        self.mask = 0

    def progress(self) -> Any:
        """Return MAG_CAL_PROGRESS; None if there is none."""
        compass = next((n for n in range(_COMPASSES) if self.mask >> n & 1), None)
        if compass is None:
            return None
        percent = round(100 * self._done / _TURNING)
        return mav.MAVLink_mag_cal_progress_message(
            compass, self.mask, mav.MAG_CAL_RUNNING_STEP_ONE, 1, min(99, percent), [0] * 10, 0, 0, 0
        )

    def _report(self, compass: int) -> Any:
        success = mav.MAG_CAL_SUCCESS
        return mav.MAVLink_mag_cal_report_message(
            compass, self.mask, success, 1, _FITNESS, *_OFFSETS, 1, 1, 1, 0, 0, 0
        )

    def _step_compass(self, seconds: float) -> None:
        vehicle = self._vehicle
        if not self.mask:
            return
        if vehicle.params["SIM_TURNED"]:
            self._done += seconds
        if self._done < _TURNING:
            return
        for compass in range(_COMPASSES):
            if self.mask >> compass & 1:
                vehicle.broadcast(self._report(compass))
                number = "" if compass == 0 else str(compass + 1)
                for axis, offset in zip("XYZ", _OFFSETS, strict=True):
                    vehicle.params.set(f"COMPASS_OFS{number}_{axis}", offset)
        self.mask = 0

    # Accelerometers

    def start_accelerometers(self) -> None:
        """Start, and ask for the first position."""
        self._wrong = False
        self._ask(1)

    def place(self, position: float) -> bool:
        """Measure in a position; return whether it is the one that is waited for."""
        if not self.position or position != self.position:
            return False
        self._wrong = self._wrong or self._vehicle.params["SIM_POSTURE"] != position
        if self.position < _POSITIONS:
            self._ask(self.position + 1)
        else:
            self._end()
        return True

    def _ask(self, position: int) -> None:
        self.position, self._repeat = position, _REPEAT
        self._vehicle.send_text(2, f"Place vehicle {_NAMES[position - 1]} and press any key.")
        self._tell(position)

    def _end(self) -> None:
        self.position = 0
        self._vehicle.send_text(
            2, "Calibration FAILED" if self._wrong else "Calibration successful"
        )
        self._tell(_FAILED if self._wrong else _SUCCESS)

    def _tell(self, position: float) -> None:
        self._vehicle.broadcast(
            mav.MAVLink_command_long_message(
                0, 0, mav.MAV_CMD_ACCELCAL_VEHICLE_POS, 0, position, 0, 0, 0, 0, 0, 0
            )
        )

    def step(self, seconds: float) -> None:
        """Continue."""
        self._step_compass(seconds)
        if self.position:
            self._repeat -= seconds
            if self._repeat <= 0:
                self._repeat = _REPEAT
                self._tell(self.position)
