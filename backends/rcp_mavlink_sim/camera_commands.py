"""Commands to gimbal and camera."""

from __future__ import annotations

from collections.abc import Callable

from rcp_mavlink_sim.requests import CommandRequest
from rcp_mavlink_sim.wire import mav

__all__ = ["DOERS"]

_MYSELF, _NOT_MINE = -2, -3
_LAST = 255
_RANGE, _AUTO = 2, (4, 5, 6)  # CAMERA_ZOOM_TYPE and SET_FOCUS_TYPE


def _mount(c: CommandRequest) -> int:
    pitch, roll, yaw = c.p[:3]
    return (
        mav.MAV_RESULT_ACCEPTED
        if c.peer.vehicle.mount.turn(pitch, yaw, roll=roll)
        else mav.MAV_RESULT_DENIED
    )


def _pitch_yaw(c: CommandRequest) -> int:
    locked = bool(int(c.p[4]) & mav.GIMBAL_MANAGER_FLAGS_YAW_LOCK)
    mount = c.peer.vehicle.gimbal(c.p[6])
    if mount is None:
        return mav.MAV_RESULT_FAILED
    turns = mount.turn(c.p[0], c.p[1], locked=locked)
    return mav.MAV_RESULT_ACCEPTED if turns else mav.MAV_RESULT_DENIED


def _take_gimbal(c: CommandRequest) -> int:
    system, component = int(c.p[0]), int(c.p[1])
    mount = c.peer.vehicle.gimbal(c.p[6])
    if mount is None or min(system, component) < _NOT_MINE or max(system, component) > _LAST:
        return mav.MAV_RESULT_FAILED
    if system == _MYSELF:
        mount.control = c.sender
    elif system >= 0:
        mount.control = (system, component)
    elif system == _NOT_MINE and mount.control == c.sender:
        mount.control = (0, 0)
    return mav.MAV_RESULT_ACCEPTED


def _photo(c: CommandRequest) -> int:
    vehicle = c.peer.vehicle
    vehicle.camera.capture(vehicle.mount, captured=c.number == mav.MAV_CMD_IMAGE_START_CAPTURE)
    return mav.MAV_RESULT_ACCEPTED


def _zoom(c: CommandRequest) -> int:
    kind, value = c.p[:2]
    if kind != _RANGE or not 0 <= value <= 100:
        return mav.MAV_RESULT_DENIED
    c.peer.vehicle.camera.zoom = value
    return mav.MAV_RESULT_ACCEPTED


def _focus(c: CommandRequest) -> int:
    kind, value = c.p[:2]
    if kind in _AUTO:
        return mav.MAV_RESULT_ACCEPTED
    if kind != _RANGE or not 0 <= value <= 100:
        return mav.MAV_RESULT_DENIED
    c.peer.vehicle.camera.focus = value
    return mav.MAV_RESULT_ACCEPTED


def _video(c: CommandRequest) -> int:
    vehicle = c.peer.vehicle
    starts = c.number == mav.MAV_CMD_VIDEO_START_CAPTURE
    vehicle.camera.recording_since = vehicle.time if starts else None
    return mav.MAV_RESULT_ACCEPTED


def _look_at(c: CommandRequest) -> int:
    """Keep a place in view with the primary gimbal, whichever the command names, like ArduPilot."""
    lat, lon, height = c.p[4:]
    if not (abs(lat) <= 90 and abs(lon) <= 180 and abs(height) <= 1e5):
        return mav.MAV_RESULT_DENIED
    c.peer.vehicle.mount.region = (lat, lon, height)
    return mav.MAV_RESULT_ACCEPTED


def _look_ahead(c: CommandRequest) -> int:
    c.peer.vehicle.mount.look_ahead()
    return mav.MAV_RESULT_ACCEPTED


DOERS: dict[int, Callable[[CommandRequest], int]] = {
    mav.MAV_CMD_DO_MOUNT_CONTROL: _mount,
    mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: _pitch_yaw,
    mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE: _take_gimbal,
    mav.MAV_CMD_DO_SET_ROI_LOCATION: _look_at,
    mav.MAV_CMD_DO_SET_ROI_NONE: _look_ahead,
    mav.MAV_CMD_DO_DIGICAM_CONTROL: _photo,
    mav.MAV_CMD_IMAGE_START_CAPTURE: _photo,
    mav.MAV_CMD_SET_CAMERA_ZOOM: _zoom,
    mav.MAV_CMD_SET_CAMERA_FOCUS: _focus,
    mav.MAV_CMD_VIDEO_START_CAPTURE: _video,
    mav.MAV_CMD_VIDEO_STOP_CAPTURE: _video,
}
"""What each command does."""
