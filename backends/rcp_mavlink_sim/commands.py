"""COMMAND_LONG and COMMAND_INT: the effect and the result of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from rcp_mavlink_sim import calibration_commands, camera_commands, payload_commands
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.requests import CommandRequest, Peer, outcome
from rcp_mavlink_sim.wire import mav

__all__ = ["DOERS", "KNOWN", "run"]

_OK, _FAILED, _DENIED = (
    mav.MAV_RESULT_ACCEPTED,
    mav.MAV_RESULT_FAILED,
    mav.MAV_RESULT_DENIED,
)
_UNSUPPORTED, _INT_ONLY = mav.MAV_RESULT_UNSUPPORTED, mav.MAV_RESULT_UNSUPPORTED
_BAD_FRAME = 9  # MAV_RESULT_COMMAND_UNSUPPORTED_MAV_FRAME, which the dialect lacks
_HIGHEST = 1e5  # m above the sea
_QUICKEST = 1e3  # m/s
_LAST_MESSAGE = 65535
_CHANGE_MODE = 1
_ERASE = 2  # PREFLIGHT_STORAGE
_NOT_AS_LONG = frozenset({mav.MAV_CMD_DO_REPOSITION})
_TURNED = frozenset({Mode.GUIDED, Mode.AUTO, Mode.RTL, Mode.LAND})
"""Modes that obey CONDITION_YAW; others accept it without effect."""
_GLOBAL_FRAMES = {0: False, 5: False, 3: True, 6: True, 10: True, 11: True}
_GROUND_FRAMES = frozenset({10, 11})


def run(
    peer: Peer,
    message: Any,
    doers: Mapping[int, Callable[[CommandRequest], int]] | None = None,
    not_as_long: frozenset[int] = _NOT_AS_LONG,
) -> int:
    """Execute it, by default as ArduPilot; return its MAV_RESULT."""
    whole = message.get_type() == "COMMAND_INT"
    if whole:
        p5, p6, p7, frame = message.x / 1e7, message.y / 1e7, message.z, message.frame
        if message.command not in _PLACES:
            p5, p6 = float(message.x), float(message.y)
    else:
        p5, p6, p7, frame = message.param5, message.param6, message.param7, 3
    if not whole and message.command in not_as_long:
        return _INT_ONLY
    do = (DOERS if doers is None else doers).get(message.command)
    if do is None:
        return _UNSUPPORTED
    p = (message.param1, message.param2, message.param3, message.param4, p5, p6, p7)
    sender = (message.get_srcSystem(), message.get_srcComponent())
    try:
        return do(CommandRequest(peer, message.command, p, frame, whole, sender))
    except (ValueError, OverflowError):  # NaN in a required parameter
        return _DENIED


def _arm(c: CommandRequest) -> int:
    vehicle = c.peer.vehicle
    if c.p[0] == 1:
        return outcome(vehicle.arm(c.p[1]))
    return outcome(vehicle.flight.disarm(c.p[1]))


def _take_off(c: CommandRequest) -> int:
    return outcome(c.peer.vehicle.flight.take_off(c.p[6]))


def _mode(mode: Mode) -> Callable[[CommandRequest], int]:
    def change(c: CommandRequest) -> int:
        vehicle = c.peer.vehicle
        if mode not in vehicle.kind.modes.values():
            return _UNSUPPORTED
        return outcome(vehicle.flight.set_mode(mode))

    return change


def _set_mode(c: CommandRequest) -> int:
    if not int(c.p[0]) & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return _UNSUPPORTED
    return outcome(c.peer.vehicle.set_custom_mode(int(c.p[1])))


def _reposition(c: CommandRequest) -> int:
    """Go to a position: a copter ignores speed and yaw, a plane ignores speed."""
    vehicle = c.peer.vehicle
    flight = vehicle.flight
    relative = _GLOBAL_FRAMES.get(c.frame)
    lat, lon = c.p[4], c.p[5]
    change = bool(int(c.p[1]) & _CHANGE_MODE)
    if flight.mode is not Mode.GUIDED and not change:
        return _DENIED
    if relative is None:
        return _BAD_FRAME
    if not (-90 <= lat <= 90 and -180 <= lon <= 180) or (lat == 0 and lon == 0):
        return _DENIED
    if not abs(c.p[6]) <= _HIGHEST:
        return _DENIED
    height = c.p[6] if relative else c.p[6] - vehicle.origin[2]
    over_ground = c.frame in _GROUND_FRAMES and vehicle.kind.flies
    if over_ground:
        above_home = vehicle.above_ground(height, vehicle.place_of(lat, lon))
        if above_home is None:
            return _FAILED
        height = above_home
    if vehicle.params["FENCE_ENABLE"] and vehicle.fence.crossed((lat, lon), height):
        return _FAILED  # without a text, like ArduPilot
    if flight.mode is not Mode.GUIDED and not vehicle.flight.set_mode(Mode.GUIDED):
        return _FAILED
    if vehicle.kind.drives and c.p[0] > 0 and not flight.change_speed(c.p[0]):
        return _FAILED
    flight.aim(vehicle.place_of(lat, lon), -height)
    flight.height_over_ground = c.p[6] if over_ground else None
    vehicle.pilot.passes = False
    return _OK


def _speed(c: CommandRequest) -> int:
    """Change a speed, if the mode and submode allow it."""
    vehicle = c.peer.vehicle
    kind, speed = c.p[0], c.p[1]
    if vehicle.kind.name == "plane":
        return outcome(_airspeed(vehicle, kind, speed))
    if not 0 < speed <= _QUICKEST:
        return _FAILED if vehicle.kind.drives else _DENIED
    which = "" if vehicle.kind.drives else {2: "up", 3: "down"}.get(int(kind), "")
    return outcome(vehicle.flight.change_speed(speed, which or "speed"))


def _airspeed(vehicle: Any, kind: float, speed: float) -> bool:
    if kind == 1:
        vehicle.send_text(6, f"Set groundspeed {speed:.0f}")
        return vehicle.flight.mode in (Mode.GUIDED, Mode.AUTO)
    least, most = vehicle.params["AIRSPEED_MIN"], vehicle.params["AIRSPEED_MAX"]
    if kind != 0 or not least <= speed <= most or not vehicle.flight.change_speed(speed):
        return False
    vehicle.send_text(6, f"Set airspeed {speed:.0f} m/s")
    return True


def _yaw(c: CommandRequest) -> int:
    """Turn a copter until the next position or set-point; other vehicles do not support it."""
    vehicle = c.peer.vehicle
    if vehicle.kind.name != "copter":
        return _UNSUPPORTED
    if not (0 <= c.p[0] <= 360 and c.p[3] in (0, 1)):
        return _FAILED
    if vehicle.flight.mode in _TURNED:
        pilot, angle = vehicle.pilot, math.radians(c.p[0])
        if c.p[3]:
            angle = pilot.yaw + math.copysign(angle, c.p[2] or 1.0)
        pilot.yaw, pilot.yaw_rate, pilot.faces_travel = angle, 0.0, False
    return _OK


def _home(c: CommandRequest) -> int:
    vehicle = c.peer.vehicle
    if not vehicle.position_ok:
        return _FAILED
    lat, lon, height = c.p[4:]
    place = abs(lat) <= 90 and abs(lon) <= 180 and abs(height) <= _HIGHEST
    if c.p[0] != 1 and (not place or lat == lon == 0):
        return _DENIED
    vehicle.set_home(None if c.p[0] == 1 else (c.p[4], c.p[5], c.p[6]))
    return _OK


def _start(c: CommandRequest) -> int:
    vehicle = c.peer.vehicle
    if c.p[0] or c.p[1]:  # running part of a mission is not supported
        return _DENIED
    if not vehicle.armed or not vehicle.flight.set_mode(Mode.AUTO):
        return _FAILED
    vehicle.flight.mission.start()
    return outcome(vehicle.flight.mission.running)


def _pause(c: CommandRequest) -> int:
    mission = c.peer.vehicle.flight.mission
    if c.peer.vehicle.flight.mode is not Mode.AUTO:
        return _FAILED
    mission.pause(paused=c.p[0] == 0)
    return _OK


def _current(c: CommandRequest) -> int:
    return outcome(c.peer.vehicle.flight.mission.go_to(int(c.p[0])))


def _terminate(c: CommandRequest) -> int:
    """Stop the motors of a copter at once; other vehicles require AFS_ENABLE."""
    vehicle = c.peer.vehicle
    if vehicle.kind.name != "copter":
        vehicle.send_text(6, "AFS not enabled, can't terminate the vehicle")
        return _FAILED
    if not c.p[0] > 0.5:
        return _FAILED
    vehicle.flight.disarm(21196)
    return _OK


def _reboot(c: CommandRequest) -> int:
    vehicle = c.peer.vehicle
    if c.p[0] not in (1, 3):
        return _DENIED if c.p[0] else _FAILED
    if vehicle.armed:
        return _FAILED
    c.peer.later(vehicle.reboot)
    return _OK


def _checks(c: CommandRequest) -> int:
    vehicle = c.peer.vehicle
    if vehicle.armed:
        return mav.MAV_RESULT_TEMPORARILY_REJECTED
    for reason in vehicle.complaints():
        vehicle.send_text(2, f"PreArm: {reason}")
    return _OK


def _interval(c: CommandRequest) -> int:
    return outcome(c.peer.streams.every(int(c.p[0]), c.p[1]))


def _which_interval(c: CommandRequest) -> int:
    number = int(c.p[0])
    if not 0 <= number <= _LAST_MESSAGE:
        return _DENIED
    c.peer.send(mav.MAVLink_message_interval_message(number, c.peer.streams.interval(number)))
    return _OK


def _request(c: CommandRequest) -> int:
    number = int(c.p[0])
    messages = c.peer.vehicle.measure(number) if number in c.peer.vehicle.makers else []
    for message in messages:
        c.peer.send(message)
    return outcome(bool(messages))


def _version(c: CommandRequest) -> int:
    vehicle = c.peer.vehicle
    c.peer.send(vehicle.makers[mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION](vehicle))
    return _OK


def _get_home(c: CommandRequest) -> int:
    message = c.peer.vehicle.home_position()
    if message is None:
        return _FAILED
    c.peer.send(message)
    return _OK


def _fence(c: CommandRequest) -> int:
    if c.p[0] not in (0, 1, 2):
        return _FAILED
    c.peer.vehicle.params.set("FENCE_ENABLE", float(c.p[0] == 1))
    return _OK


def _motor_test(c: CommandRequest) -> int:
    """Turn one motor for a while; what is not a copter has no such test."""
    vehicle = c.peer.vehicle
    if vehicle.kind.name != "copter":
        return _UNSUPPORTED
    return outcome(vehicle.motor_test.begin(c.p[0], c.p[1], c.p[2], c.p[3]))


def _storage(c: CommandRequest) -> int:
    """Reset the parameters; there is nothing else to store, as each write is stored at once."""
    vehicle = c.peer.vehicle
    if c.p[0] != _ERASE:
        return _DENIED
    vehicle.params.erase()
    vehicle.send_text(4, "All parameters reset, reboot board")
    return _OK


_PLACES = frozenset({16, 17, 18, 19, 21, 22, 34, 82, 179, 192, 195, 201})
DOERS: dict[int, Callable[[CommandRequest], int]] = {
    mav.MAV_CMD_COMPONENT_ARM_DISARM: _arm,
    mav.MAV_CMD_NAV_TAKEOFF: _take_off,
    mav.MAV_CMD_NAV_LAND: _mode(Mode.LAND),
    mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: _mode(Mode.RTL),
    mav.MAV_CMD_NAV_LOITER_UNLIM: _mode(Mode.LOITER),
    mav.MAV_CMD_DO_SET_MODE: _set_mode,
    mav.MAV_CMD_DO_REPOSITION: _reposition,
    mav.MAV_CMD_DO_CHANGE_SPEED: _speed,
    mav.MAV_CMD_CONDITION_YAW: _yaw,
    mav.MAV_CMD_DO_SET_HOME: _home,
    mav.MAV_CMD_MISSION_START: _start,
    mav.MAV_CMD_DO_PAUSE_CONTINUE: _pause,
    mav.MAV_CMD_DO_SET_MISSION_CURRENT: _current,
    mav.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
    mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    mav.MAV_CMD_PREFLIGHT_STORAGE: _storage,
    mav.MAV_CMD_RUN_PREARM_CHECKS: _checks,
    mav.MAV_CMD_SET_MESSAGE_INTERVAL: _interval,
    mav.MAV_CMD_GET_MESSAGE_INTERVAL: _which_interval,
    mav.MAV_CMD_REQUEST_MESSAGE: _request,
    mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _version,
    mav.MAV_CMD_GET_HOME_POSITION: _get_home,
    mav.MAV_CMD_DO_FENCE_ENABLE: _fence,
    mav.MAV_CMD_DO_MOTOR_TEST: _motor_test,
    **payload_commands.DOERS,
    **calibration_commands.DOERS,
    **camera_commands.DOERS,
}
"""What each command does."""
KNOWN = frozenset(DOERS)
"""The supported commands."""
