"""The messages of gimbal and camera. Angles are deg except on the wire."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rcp_mavlink_sim.camera import HEIGHT, WIDTH
from rcp_mavlink_sim.mount import Mount, quaternion
from rcp_mavlink_sim.sensing import milliseconds
from rcp_mavlink_sim.systems import Systems
from rcp_mavlink_sim.wire import mav

__all__ = ["MAKERS"]

_ABLE = (
    mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_RETRACT
    | mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_NEUTRAL
    | mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_AXIS
    | mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_LOCK
    | mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_AXIS
    | mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_FOLLOW
    | mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_LOCK
)


def _status(v: Systems) -> Any:
    mount = v.mount
    return mav.MAVLink_mount_status_message(
        0, 0, round(mount.pitch * 100), round(mount.roll * 100), round(mount.yaw * 100)
    )


def _each(make: Callable[[Systems, Mount], Any]) -> Callable[[Systems], list[Any]]:
    """Make a message for each gimbal that is fitted."""
    return lambda v: [make(v, mount) for mount in v.mounts if mount.fitted]


def _device(v: Systems, mount: Mount) -> Any:
    roll, pitch, yaw = (math.radians(a) for a in (mount.roll, mount.pitch, mount.yaw))
    q = quaternion(roll, pitch, yaw)
    nan = math.nan
    return mav.MAVLink_gimbal_device_attitude_status_message(
        0, 0, milliseconds(v), mount.flags(), q, nan, nan, nan, 0, v.body.yaw, nan, mount.number
    )


def _ranges(mount: Mount) -> tuple[float, ...]:
    """Return roll, pitch and yaw, each from the least to the largest, rad."""
    degrees = (0.0, 0.0, *mount.range("PITCH"), *mount.range("YAW"))
    return tuple(math.radians(angle) for angle in degrees)


def _manager(v: Systems, mount: Mount) -> Any:
    return mav.MAVLink_gimbal_manager_information_message(
        milliseconds(v), _ABLE, mount.number, *_ranges(mount)
    )


def _manager_status(v: Systems, mount: Mount) -> Any:
    return mav.MAVLink_gimbal_manager_status_message(
        milliseconds(v), mount.flags(), mount.number, *mount.control, 0, 0
    )


def _gimbal(v: Systems, mount: Mount) -> Any:
    ranges = _ranges(mount)
    return mav.MAVLink_gimbal_device_information_message(
        milliseconds(v), b"rcp", b"simulated", b"", 0, 0, 0, _ABLE, 0, *ranges, mount.number
    )


def _camera(v: Systems) -> Any:
    nothing, able = math.nan, mav.CAMERA_CAP_FLAGS_CAPTURE_IMAGE
    able |= mav.CAMERA_CAP_FLAGS_CAPTURE_VIDEO
    able |= mav.CAMERA_CAP_FLAGS_HAS_BASIC_ZOOM | mav.CAMERA_CAP_FLAGS_HAS_BASIC_FOCUS
    return mav.MAVLink_camera_information_message(
        milliseconds(v), list(b"rcp".ljust(32, b"\0")), list(b"simulated".ljust(32, b"\0")), 0,
        nothing, nothing, nothing, WIDTH, HEIGHT, 0, able, 0, b"",
    )  # fmt: skip


def _captures(v: Systems) -> Any:
    since = v.camera.recording_since
    recorded = 0 if since is None else round((v.time - since) * 1000)
    return mav.MAVLink_camera_capture_status_message(
        milliseconds(v), 0, int(since is not None), 0.0, recorded, 0.0, v.mount.photos
    )


def _settings(v: Systems) -> Any:
    camera = v.camera
    return mav.MAVLink_camera_settings_message(milliseconds(v), 0, camera.zoom, camera.focus)


MAKERS: dict[int, Callable[[Systems], Any]] = {
    mav.MAVLINK_MSG_ID_MOUNT_STATUS: _status,
    mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: _each(_device),
    mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION: _each(_manager),
    mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION: _each(_gimbal),
    mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS: _each(_manager_status),
    mav.MAVLINK_MSG_ID_CAMERA_INFORMATION: _camera,
    mav.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS: _captures,
    mav.MAVLINK_MSG_ID_CAMERA_SETTINGS: _settings,
}
"""The messages of gimbal and camera, by id."""
