"""Commands that calibrate sensors."""

from __future__ import annotations

from collections.abc import Callable

from rcp_mavlink_sim.requests import CommandRequest, outcome
from rcp_mavlink_sim.wire import mav

__all__ = ["DOERS"]


def _calibrate(c: CommandRequest) -> int:
    vehicle = c.peer.vehicle
    if vehicle.armed:
        vehicle.send_text(4, "Disarm to allow calibration")
        return mav.MAV_RESULT_FAILED
    if c.p[0] == 1:
        vehicle.send_text(6, "Calibrating gyros")
        return mav.MAV_RESULT_ACCEPTED
    if c.p[2] == 1:
        vehicle.send_text(6, "Calibrating barometer")
        vehicle.send_text(6, "Barometer calibration complete")
        return mav.MAV_RESULT_ACCEPTED
    vehicle.calibrations.radio = c.p[3] > 0  # which alone is no result
    if c.p[4] == 1:
        vehicle.calibrations.start_accelerometers()
    elif c.p[4] not in (2, 4):
        return mav.MAV_RESULT_UNSUPPORTED
    return mav.MAV_RESULT_ACCEPTED


def _start_compass(c: CommandRequest) -> int:
    return outcome(c.peer.vehicle.calibrations.start_compass(c.p[0]))


def _accept_compass(_: CommandRequest) -> int:
    """Nothing waits to be accepted: every result is saved at once."""
    return mav.MAV_RESULT_FAILED


def _cancel_compass(c: CommandRequest) -> int:
    c.peer.vehicle.calibrations.cancel_compass()
    return mav.MAV_RESULT_ACCEPTED


def _place(c: CommandRequest) -> int:
    return outcome(c.peer.vehicle.calibrations.place(c.p[0]))


DOERS: dict[int, Callable[[CommandRequest], int]] = {
    mav.MAV_CMD_PREFLIGHT_CALIBRATION: _calibrate,
    mav.MAV_CMD_DO_START_MAG_CAL: _start_compass,
    mav.MAV_CMD_DO_ACCEPT_MAG_CAL: _accept_compass,
    mav.MAV_CMD_DO_CANCEL_MAG_CAL: _cancel_compass,
    mav.MAV_CMD_ACCELCAL_VEHICLE_POS: _place,
}
"""What each command does."""
