"""The messages that PX4 sends, and how often without a request."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rcp_mavlink_sim import mount_messages
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.px4.metadata import ComponentMetadata, component_metadata
from rcp_mavlink_sim.sensing import microseconds, milliseconds
from rcp_mavlink_sim.systems import Systems
from rcp_mavlink_sim.telemetry import MAKERS as SHARED
from rcp_mavlink_sim.telemetry import state_of
from rcp_mavlink_sim.wire import mav

__all__ = ["MAKERS", "USUAL"]

_CAPABLE = (
    mav.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mav.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mav.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mav.MAV_PROTOCOL_CAPABILITY_FTP
    | mav.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mav.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
)
_MANUAL = (Mode.MANUAL, Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER)


def heartbeat(v: Systems) -> Any:
    """Return the HEARTBEAT."""
    mode = v.flight.mode
    flags = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mav.MAV_MODE_FLAG_STABILIZE_ENABLED
    if mode in _MANUAL:
        flags |= mav.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    else:
        flags |= mav.MAV_MODE_FLAG_AUTO_ENABLED | mav.MAV_MODE_FLAG_GUIDED_ENABLED
    flags |= mav.MAV_MODE_FLAG_SAFETY_ARMED if v.armed else 0
    return mav.MAVLink_heartbeat_message(
        v.kind.type, mav.MAV_AUTOPILOT_PX4, flags, v.kind.number(mode), state_of(v), 3
    )


def _version(v: Systems) -> Any:
    release = (1 << 24) | (16 << 16) | mav.FIRMWARE_VERSION_TYPE_OFFICIAL
    hashed = list(bytes.fromhex("1c8ab2a0a1b2c3d4"))
    own = list(v.options.system.to_bytes(18, "big"))
    return mav.MAVLink_autopilot_version_message(
        _CAPABLE, release, release, 0, 0, hashed, hashed, hashed, 0x26AC, 0x0010, v.options.system, own
    )  # fmt: skip


def _estimator(v: Systems) -> Any:
    flags = 0b0011_1111_1111 if v.position_ok else 0b0000_0000_0101
    return mav.MAVLink_estimator_status_message(
        microseconds(v), flags, 0.02, 0.03, 0.02, 0.05, 0.0, 0.0, 0.3, 0.5
    )


def _wind(v: Systems) -> Any:
    n, e, nan = v.body.wind_n, v.body.wind_e, math.nan
    return mav.MAVLink_wind_cov_message(microseconds(v), n, e, 0.0, 0.1, 0.1, -v.body.d, nan, nan)


def _mission(v: Systems) -> Any:
    """Return MISSION_CURRENT: PX4 has no home in its missions, and counts from 0."""
    mission = v.flight.mission
    total = max(0, len(mission.plan.items) - 1)
    state = mav.MISSION_STATE_NO_MISSION
    if total:
        begun = mav.MISSION_STATE_PAUSED if mission.current > 1 else mav.MISSION_STATE_NOT_STARTED
        state = mav.MISSION_STATE_ACTIVE if mission.running else begun
        state = mav.MISSION_STATE_COMPLETE if mission.complete else state
    return mav.MAVLink_mission_current_message(max(0, mission.current - 1), total, state, 1)


_SENT = (
    mav.MAVLINK_MSG_ID_SYS_STATUS, mav.MAVLINK_MSG_ID_SYSTEM_TIME, mav.MAVLINK_MSG_ID_GPS_RAW_INT,
    mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mav.MAVLINK_MSG_ID_VFR_HUD, mav.MAVLINK_MSG_ID_BATTERY_STATUS, mav.MAVLINK_MSG_ID_RC_CHANNELS,
    mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, mav.MAVLINK_MSG_ID_HIGHRES_IMU,
    mav.MAVLINK_MSG_ID_SCALED_PRESSURE, mav.MAVLINK_MSG_ID_VIBRATION, mav.MAVLINK_MSG_ID_HOME_POSITION,
    mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT, mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
    mav.MAVLINK_MSG_ID_DISTANCE_SENSOR, mav.MAVLINK_MSG_ID_ADSB_VEHICLE,
)  # fmt: skip
MAKERS: dict[int, Callable[[Systems], Any]] = {
    **{number: SHARED[number] for number in _SENT},
    **mount_messages.MAKERS,
    mav.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _version,
    mav.MAVLINK_MSG_ID_ESTIMATOR_STATUS: _estimator,
    mav.MAVLINK_MSG_ID_WIND_COV: _wind,
    mav.MAVLINK_MSG_ID_MISSION_CURRENT: _mission,
    ComponentMetadata.id: lambda v: component_metadata(milliseconds(v)),
}
"""Builders of the available messages, by id; they return None while there is no value."""
del MAKERS[mav.MAVLINK_MSG_ID_MOUNT_STATUS]  # of the older protocol

USUAL: dict[int, float] = {
    mav.MAVLINK_MSG_ID_HEARTBEAT: 1.0, mav.MAVLINK_MSG_ID_ATTITUDE: 1 / 15,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.2, mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
    mav.MAVLINK_MSG_ID_SYS_STATUS: 1.0, mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    mav.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0, mav.MAVLINK_MSG_ID_BATTERY_STATUS: 2.0,
    mav.MAVLINK_MSG_ID_HOME_POSITION: 2.0, mav.MAVLINK_MSG_ID_VFR_HUD: 0.25,
    mav.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 2.0, mav.MAVLINK_MSG_ID_VIBRATION: 10.0,
}  # fmt: skip
"""Seconds between two of a message that it sends without a request (the profile `normal`)."""
