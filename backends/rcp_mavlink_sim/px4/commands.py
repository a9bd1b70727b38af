"""PX4's commands, where they differ from ArduPilot's: heights from the sea, NaN for what is not set."""

from __future__ import annotations

import math
from collections.abc import Callable

from rcp_mavlink_sim import camera_commands, commands
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.px4.calibrations import Px4Calibrations
from rcp_mavlink_sim.px4.fence import Px4Fence
from rcp_mavlink_sim.px4.flight import HOLD, Px4Flight
from rcp_mavlink_sim.requests import CommandRequest
from rcp_mavlink_sim.wire import mav

__all__ = ["DOERS"]

_OK, _REJECTED, _DENIED, _UNSUPPORTED = (
    mav.MAV_RESULT_ACCEPTED,
    mav.MAV_RESULT_TEMPORARILY_REJECTED,
    mav.MAV_RESULT_DENIED,
    mav.MAV_RESULT_UNSUPPORTED,
)
_CHANGE_MODE = 1
_RELATIVE = (3, 6)
_NOWHERE = 214.0  # deg: INT32_MAX, which is no place in a COMMAND_INT
_SAVED = (0, 1)  # PREFLIGHT_STORAGE: load, save
_ERASE = 2
_QUICKEST = 1e3  # m/s
_LARGEST = 1e3  # m
_QUICK = 4  # of PREFLIGHT_CALIBRATION


def _flight(c: CommandRequest) -> Px4Flight:
    flight = c.peer.vehicle.flight
    assert isinstance(flight, Px4Flight)
    return flight


def _outcome(done: bool) -> int:  # noqa: FBT001 - the outcome, as a result code
    return _OK if done else _REJECTED


def _arm(c: CommandRequest) -> int:
    vehicle = c.peer.vehicle
    if c.p[0] not in (0, 1):
        return _UNSUPPORTED
    return _outcome(vehicle.arm(c.p[1]) if c.p[0] else vehicle.flight.disarm(c.p[1]))


def _set_mode(c: CommandRequest) -> int:
    if not int(c.p[0]) & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return _DENIED
    return _outcome(c.peer.vehicle.set_custom_mode(int(c.p[1]) << 16 | int(c.p[2]) << 24))


def _mode(mode: Mode) -> Callable[[CommandRequest], int]:
    return lambda c: _outcome(c.peer.vehicle.flight.set_mode(mode))


def _height(c: CommandRequest) -> float | None:
    """Return its height above home, m; None if it is not set."""
    height, vehicle = c.p[6], c.peer.vehicle
    if not math.isfinite(height):
        return None
    relative = c.whole and c.frame in _RELATIVE
    return height if relative else height - (vehicle.home or vehicle.origin)[2]


def _place(c: CommandRequest) -> tuple[float, float] | None:
    """Return its position from the origin, m; None if it is not set."""
    lat, lon = c.p[4:6]
    if not (math.isfinite(lat) and math.isfinite(lon)) or max(lat, lon) > _NOWHERE:
        return None
    return c.peer.vehicle.place_of(lat, lon)


def _take_off(c: CommandRequest) -> int:
    vehicle, height = c.peer.vehicle, _height(c)
    usual = vehicle.params["MIS_TAKEOFF_ALT"] - vehicle.body.d
    return _outcome(_flight(c).take_off(usual if height is None else height))


def _reposition(c: CommandRequest) -> int:
    """Go to a position in HOLD, also as COMMAND_LONG; without one, it stops where it is."""
    if math.isnan(c.p[1]) or not int(c.p[1]) & _CHANGE_MODE:
        return _UNSUPPORTED
    flight, height, place = _flight(c), _height(c), _place(c)
    if place is not None and not all(abs(part) < 1e6 for part in place):
        return _DENIED
    if not flight.set_mode(HOLD):
        return _REJECTED
    vehicle = c.peer.vehicle
    assert isinstance(vehicle.fence, Px4Fence)
    at = vehicle.geographic() if place is None else (c.p[4], c.p[5])
    if not vehicle.fence.allows(at, -vehicle.body.d if height is None else height):
        vehicle.send_text(2, "Reposition is outside geofence")
        return _OK  # of the commander, which does not know what the navigator does
    flight.reposition(place, None if height is None else -height, c.p[0], c.p[3])
    return _OK


def _orbit(c: CommandRequest) -> int:
    radius, speed, place = c.p[0], c.p[1], _place(c)
    if not 1 <= abs(radius) <= _LARGEST or place is None:
        return _DENIED
    height = _height(c)
    fine = math.isfinite(speed) and speed > 0
    depth = None if height is None else -height
    return _outcome(_flight(c).orbit(place, radius, speed if fine else 2.0, depth))


def _speed(c: CommandRequest) -> int:
    kind, speed = c.p[:2]
    if kind not in (0, 1) or not 0 < speed <= _QUICKEST:
        return _DENIED
    c.peer.vehicle.flight.change_speed(min(speed, c.peer.vehicle.params["MPC_XY_VEL_MAX"]))
    return _OK


def _current(c: CommandRequest) -> int:
    """Set the current item, of which the first is 0."""
    return _outcome(c.peer.vehicle.flight.mission.go_to(int(c.p[0]) + 1))


def _start(c: CommandRequest) -> int:
    return _outcome(c.peer.vehicle.flight.set_mode(Mode.AUTO))


def _storage(c: CommandRequest) -> int:
    if c.p[0] == _ERASE:
        c.peer.vehicle.params.erase()
    return _OK if c.p[0] in (*_SAVED, _ERASE) else _DENIED


def _terminate(c: CommandRequest) -> int:
    if not c.p[0] > 0.5:
        return _OK
    c.peer.vehicle.flight.disarm(21196)
    return _OK


def _checks(c: CommandRequest) -> int:
    if c.peer.vehicle.armed:
        return _REJECTED
    for reason in c.peer.vehicle.complaints():
        c.peer.vehicle.send_text(2, f"Preflight Fail: {reason}")
    return _OK


def _calibrate(c: CommandRequest) -> int:
    """Calibrate one thing; nothing at all ends what is under way."""
    calibrations, vehicle = c.peer.vehicle.calibrations, c.peer.vehicle
    assert isinstance(calibrations, Px4Calibrations)
    if not any(c.p):
        calibrations.cancel()
        return _OK
    if vehicle.armed or calibrations.what is not None:
        return _REJECTED
    if c.p[3] == 1:
        calibrations.ignore_sticks()
        return _OK
    wanted = (
        (0, 1, "gyro"),
        (1, 1, "mag"),
        (2, 1, "baro"),
        (4, 1, "accel"),
        (4, 2, "level"),
        (4, 4, "accel"),
    )
    what = next((name for place, value, name in wanted if c.p[place] == value), None)
    if what is None:
        return _DENIED
    if c.p[4] == _QUICK:
        calibrations.measure_at_once()
    else:
        calibrations.begin(what)
    return _OK


def _pitch_yaw(c: CommandRequest) -> int:
    """Turn the gimbal for who controls it."""
    mount = c.peer.vehicle.gimbal(c.p[6])
    if mount is not None and mount.control != c.sender:
        return _DENIED
    return camera_commands.DOERS[mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW](c)


_SHARED = (
    mav.MAV_CMD_DO_SET_HOME, mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, mav.MAV_CMD_SET_MESSAGE_INTERVAL,
    mav.MAV_CMD_GET_MESSAGE_INTERVAL, mav.MAV_CMD_REQUEST_MESSAGE,
    mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, mav.MAV_CMD_GET_HOME_POSITION, mav.MAV_CMD_DO_MOTOR_TEST,
)  # fmt: skip
DOERS: dict[int, Callable[[CommandRequest], int]] = {
    **{number: commands.DOERS[number] for number in _SHARED},
    **camera_commands.DOERS,
    mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: _pitch_yaw,
    mav.MAV_CMD_COMPONENT_ARM_DISARM: _arm,
    mav.MAV_CMD_DO_SET_MODE: _set_mode,
    mav.MAV_CMD_NAV_TAKEOFF: _take_off,
    mav.MAV_CMD_NAV_LAND: _mode(Mode.LAND),
    mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: _mode(Mode.RTL),
    mav.MAV_CMD_NAV_LOITER_UNLIM: _mode(HOLD),
    mav.MAV_CMD_DO_REPOSITION: _reposition,
    mav.MAV_CMD_DO_ORBIT: _orbit,
    mav.MAV_CMD_DO_CHANGE_SPEED: _speed,
    mav.MAV_CMD_DO_SET_MISSION_CURRENT: _current,
    mav.MAV_CMD_MISSION_START: _start,
    mav.MAV_CMD_PREFLIGHT_STORAGE: _storage,
    mav.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
    mav.MAV_CMD_RUN_PREARM_CHECKS: _checks,
    mav.MAV_CMD_PREFLIGHT_CALIBRATION: _calibrate,
}
"""What each command does."""
