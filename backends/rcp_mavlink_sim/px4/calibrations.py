"""PX4's calibrations: one at a time, told by status texts that begin with `[cal]`."""

from __future__ import annotations

from rcp_mavlink_sim.calibrations import Calibrations
from rcp_mavlink_sim.state import VehicleState

__all__ = ["Px4Calibrations"]

_SIDES = ("back", "front", "left", "right", "up", "down")
_POSTURES = ("down", "left", "right", "front", "back", "up")
"""The side that points down, by `SIM_POSTURE` from 1."""
_BY_SIDES = ("accel", "mag")
_LASTING = {"gyro": 3.0, "baro": 1.0, "level": 2.0}  # s
_STILL, _MEASURING, _TURNING = 0.5, 1.0, 2.0  # s
_PATIENCE = 7.0  # s to turn it
_TRIES = 5  # sides in a row that were done already
_SHARE = 100 // len(_SIDES)  # % of a side
_STEPS = 4  # texts with progress for each side


class Px4Calibrations(Calibrations):
    """The calibrations of one vehicle; `SIM_TURNED` and `SIM_POSTURE` are as for ArduPilot."""

    def __init__(self, vehicle: VehicleState) -> None:
        super().__init__(vehicle)
        self.what: str | None = None
        """What is calibrated now."""
        self._for = 0.0
        self._done: list[str] = []
        self._side: str | None = None
        self._turned = 0.0
        self._told = 0
        self._again = 0

    def begin(self, what: str) -> None:
        """Start one."""
        self.what, self._for, self._done, self._side = what, 0.0, [], None
        self._told = self._again = 0
        self._say(f"calibration started: 2 {what}")
        if what in _BY_SIDES:
            self._ask_side()

    def measure_at_once(self) -> None:
        """Calibrate the accelerometers as it lies there."""
        self._say("calibration started: 2 accel")
        self._finish("accel")

    def cancel(self) -> None:
        """End it without a result, and heed the sticks again."""
        if self.what is not None:
            self.what = None
            self._say("calibration cancelled", 2)
        if self.radio:
            self.radio = False
            self._vehicle.send_text(6, "Calibration: Restoring RC input")

    def ignore_sticks(self) -> None:
        """Heed no remote control, because a ground station calibrates it."""
        self.radio = True
        self._vehicle.send_text(6, "Calibration: Disabling RC input")

    def step(self, seconds: float) -> None:
        """Continue."""
        if self.what is None:
            return
        self._for += seconds
        if self.what in _BY_SIDES:
            self._step_sides(self.what, seconds)
        else:
            self._step_still(self.what)

    def _step_still(self, what: str) -> None:
        part = min(1.0, self._for / _LASTING[what])
        if int(part * 10) > self._told:
            self._told = int(part * 10)
            self._say(f"progress <{10 * self._told}>")
        if part >= 1.0:
            self._finish(what)

    def _step_sides(self, what: str, seconds: float) -> None:
        side = _POSTURES[int(self._vehicle.params["SIM_POSTURE"]) - 1]
        turned = bool(self._vehicle.params["SIM_TURNED"])
        if self._side is None:
            self._detect(side, turned=turned)
        elif what == "accel":
            if self._for >= _MEASURING:
                self._complete(what)
        else:
            self._turn(self._side, seconds if turned else 0.0)

    def _detect(self, side: str, *, turned: bool) -> None:
        if turned:
            self._for = 0.0
        elif self._for >= _STILL:
            self._for = 0.0
            self._say("detected rest position, hold still...")
            if side not in self._done:
                self._side, self._turned, self._told, self._again = side, 0.0, 0, 0
                self._say(f"{side} orientation detected")
                measuring = self.what == "accel"
                self._say(f"Hold still, measuring {side} side" if measuring else "Rotate vehicle")
                return
            self._say(f"{side} side already completed")
            self._again += 1
            if self._again >= _TRIES:
                self._fail("timeout: no motion")
            else:
                self._ask_side()

    def _turn(self, side: str, seconds: float) -> None:
        self._turned += seconds
        step = min(_STEPS, int(_STEPS * self._turned / _TURNING))
        if step > self._told:
            self._told = step
            done = len(self._done) * _SHARE + _SHARE * step // _STEPS
            self._say(f"{side} side calibration: progress <{done}>")
        if self._turned >= _TURNING:
            self._complete("mag")
        elif self._for > _PATIENCE:
            self._fail("timeout: no motion")

    def _complete(self, what: str) -> None:
        assert self._side is not None
        self._done.append(self._side)
        self._say(f"{self._side} side done, rotate to a different side")
        self._say(f"progress <{min(100, len(self._done) * (_SHARE + 1))}>")
        self._side, self._for = None, 0.0
        if len(self._done) == len(_SIDES):
            self._finish(what)
        else:
            self._ask_side()

    def _ask_side(self) -> None:
        left = " ".join(side for side in _SIDES if side not in self._done)
        self._say(f"pending: {left}")
        self._say("hold vehicle still on a pending side")

    def _finish(self, what: str) -> None:
        self.what = None
        if what in _BY_SIDES:
            sensor = {"accel": "ACC", "mag": "MAG"}[what]
            for axis, offset in zip("XYZ", (0.02, -0.01, 0.03), strict=True):
                self._vehicle.params.set(f"CAL_{sensor}0_{axis}OFF", offset)
        self._say(f"calibration done: {what}")

    def _fail(self, why: str) -> None:
        self.what = None
        self._say(f"calibration failed: {why}", 2)

    def _say(self, text: str, severity: int = 6) -> None:
        self._vehicle.send_text(severity, f"[cal] {text}")
