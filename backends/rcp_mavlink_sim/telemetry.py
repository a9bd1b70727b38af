"""The telemetry messages, built when due or requested."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from rcp_mavlink.geo import shifted
from rcp_mavlink_sim import mount_messages, sensing
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.mount import quaternion
from rcp_mavlink_sim.sensing import milliseconds as _ms
from rcp_mavlink_sim.systems import Systems
from rcp_mavlink_sim.wire import mav

__all__ = ["MAKERS", "heartbeat", "state_of"]

_GPS, _LEVEL, _PLACE, _MOTORS, _FENCE, _AHRS, _BATTERY = (
    mav.MAV_SYS_STATUS_SENSOR_GPS,
    mav.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL,
    mav.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL,
    mav.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS,
    mav.MAV_SYS_STATUS_GEOFENCE,
    mav.MAV_SYS_STATUS_AHRS,
    mav.MAV_SYS_STATUS_SENSOR_BATTERY,
)
_RECEIVER = mav.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
_SENSORS = (
    mav.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mav.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mav.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mav.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mav.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    | mav.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
    | mav.MAV_SYS_STATUS_SENSOR_YAW_POSITION
    | mav.MAV_SYS_STATUS_LOGGING
    | _GPS | _LEVEL | _PLACE | _MOTORS | _FENCE | _AHRS | _BATTERY | _RECEIVER
)  # fmt: skip
_PREARM = mav.MAV_SYS_STATUS_PREARM_CHECK
_CAPABLE = (
    mav.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mav.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mav.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mav.MAV_PROTOCOL_CAPABILITY_FTP
    | mav.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mav.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
)


def heartbeat(v: Systems) -> Any:
    """Return the HEARTBEAT."""
    mode = v.flight.mode
    flags = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mav.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    flags |= 0 if mode is Mode.MANUAL else mav.MAV_MODE_FLAG_STABILIZE_ENABLED
    flags |= 0 if v.kind.by_hand(mode) else mav.MAV_MODE_FLAG_GUIDED_ENABLED
    flags |= mav.MAV_MODE_FLAG_SAFETY_ARMED if v.armed or v.motor_test.motor else 0
    return mav.MAVLink_heartbeat_message(
        v.kind.type, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, flags, v.kind.number(mode), state_of(v), 3
    )


def state_of(v: Systems) -> int:
    """Return its MAV_STATE."""
    if v.failsafes.any:
        return mav.MAV_STATE_CRITICAL
    moving = v.armed and (not v.body.landed or not v.kind.flies)
    return mav.MAV_STATE_ACTIVE if moving else mav.MAV_STATE_STANDBY


def _sys_status(v: Systems) -> Any:
    present = _SENSORS | _PREARM
    by_hand = v.kind.by_hand(v.flight.mode)
    off = (_PLACE if by_hand else 0) | (0 if v.armed else _MOTORS)
    off |= 0 if v.params["FENCE_ENABLE"] else _FENCE
    failed = (0 if v.gps_ok else _GPS) | (0 if v.position_ok else _AHRS)
    failed |= (_FENCE if v.fence.breached else 0) | (_RECEIVER if v.failsafes.radio_lost else 0)
    failed |= (_BATTERY if v.failsafes.battery_low else 0) | (0 if v.ready else _PREARM)
    battery = v.battery
    volts = round((battery.voltage + v.noise.white(0.01)) * 1000)
    return mav.MAVLink_sys_status_message(
        present, present & ~off, present & ~failed, 250, volts, round(battery.current * 100),
        round(battery.charge * 100), 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


def _attitude(v: Systems) -> Any:
    return mav.MAVLink_attitude_message(_ms(v), *sensing.attitude(v))


def _attitude_quaternion(v: Systems) -> Any:
    roll, pitch, yaw, *rates = sensing.attitude(v)
    return mav.MAVLink_attitude_quaternion_message(_ms(v), *quaternion(roll, pitch, yaw), *rates)


def _estimate(v: Systems) -> tuple[float, float, float, float, float, float]:
    b, slow = v.body, v.noise.slow
    return (
        b.n + slow("n"), b.e + slow("e"), b.d + slow("d"),
        b.vn + slow("vn"), b.ve + slow("ve"), b.vd + slow("vd"),
    )  # fmt: skip


def _local(v: Systems) -> Any:
    if not v.position_ok:
        return None
    n, e, d, *speeds = _estimate(v)
    north, east, down = v.from_origin()
    return mav.MAVLink_local_position_ned_message(_ms(v), n - north, e - east, d - down, *speeds)


def _global(v: Systems) -> Any:
    n, e, d, *speeds = _estimate(v)
    if v.position_ok:
        v.seen_at = (n, e)
    else:  # like ArduPilot: the last position, at rest, whatever the vehicle does
        n, e = v.seen_at
        speeds[:2] = (0.0, 0.0)
    lat, lon = shifted(n, e, v.origin[:2]) if v.home is not None else (0.0, 0.0)
    height = v.origin[2] - d
    over_home = height - (v.home or v.origin)[2]
    heading = round(math.degrees(v.body.yaw + v.noise.slow("yaw")) % 360 * 100) % 36000
    return mav.MAVLink_global_position_int_message(
        _ms(v), round(lat * 1e7), round(lon * 1e7), round(height * 1000), round(over_home * 1000),
        *(round(speed * 100) for speed in speeds), heading,
    )  # fmt: skip


def _hud(v: Systems) -> Any:
    b = v.body
    speed = math.hypot(b.vn, b.ve) if v.position_ok else 0.0
    air = math.hypot(b.vn - b.wind_n, b.ve - b.wind_e)
    heading = round(math.degrees(b.yaw)) % 360
    return mav.MAVLink_vfr_hud_message(
        air, speed, heading, round(b.throttle * 100), v.origin[2] - b.d, -b.vd
    )


def _ekf(v: Systems) -> Any:
    flags = 1 | 2 | 4 | 8 | 16 | 32 | 256 | 512 if v.position_ok else 1 | 4 | 32 | 128
    a, b, c, d = (abs(x + v.noise.white(x / 3)) for x in (0.02, 0.02, 0.01, 0.03))
    return mav.MAVLink_ekf_status_report_message(flags, a, b, c, d, 0.0)


def _wind(v: Systems) -> Any:
    n, e = v.body.wind_n, v.body.wind_e
    return mav.MAVLink_wind_message(math.degrees(math.atan2(-e, -n)), math.hypot(n, e), 0.0)


def _landed(v: Systems) -> Any:
    if not v.kind.flies:
        state = mav.MAV_LANDED_STATE_UNDEFINED
    elif v.body.landed:
        state = mav.MAV_LANDED_STATE_ON_GROUND
    elif v.flight.taking_off:
        state = mav.MAV_LANDED_STATE_TAKEOFF
    elif v.flight.landing:
        state = mav.MAV_LANDED_STATE_LANDING
    else:
        state = mav.MAV_LANDED_STATE_IN_AIR
    return mav.MAVLink_extended_sys_state_message(0, state)


def _mission(v: Systems) -> Any:
    mission = v.flight.mission
    total = max(0, len(mission.plan.items) - 1)
    if not total:
        state = mav.MISSION_STATE_NO_MISSION
    elif mission.complete:
        state = mav.MISSION_STATE_COMPLETE
    elif mission.paused:
        state = mav.MISSION_STATE_PAUSED
    else:
        started = mission.running or mission.current
        state = mav.MISSION_STATE_ACTIVE if started else mav.MISSION_STATE_NOT_STARTED
    return mav.MAVLink_mission_current_message(mission.current, total, state, 1)


def _controller(v: Systems) -> Any:
    b, pilot = v.body, v.pilot
    n, e = pilot.place or (b.n, b.e)
    bearing = round(math.degrees(math.atan2(e - b.e, n - b.n)))
    depth = b.d if pilot.depth is None else pilot.depth
    return mav.MAVLink_nav_controller_output_message(
        math.degrees(b.roll), math.degrees(b.pitch), bearing, bearing,
        min(65535, round(math.hypot(n - b.n, e - b.e))), b.d - depth, 0.0, 0.0,
    )  # fmt: skip


def _target(v: Systems) -> Any:
    pilot = v.pilot
    n, e = pilot.place or (v.body.n, v.body.e)
    depth = v.body.d if pilot.depth is None else pilot.depth
    vn, ve = pilot.velocity
    return mav.MAVLink_position_target_local_ned_message(
        _ms(v), 1, 0x0DC0, n, e, depth, vn, ve, pilot.sinking, 0, 0, 0, pilot.yaw, pilot.yaw_rate
    )


def _fence(v: Systems) -> Any:
    kinds = {0: 0, 1: 2, 2: 3, 4: 3, 8: 1}
    kind = next((kinds[bit] for bit in (1, 2, 4, 8) if v.fence.breached & bit), 0)
    return mav.MAVLink_fence_status_message(
        int(bool(v.fence.breached)), v.fence.count, kind, _ms(v), 0
    )


def _system_time(v: Systems) -> Any:
    return mav.MAVLink_system_time_message(round(time.time() * 1e6), _ms(v))


def _winch(v: Systems) -> Any:
    winch, nan = v.payloads, math.nan
    return mav.MAVLink_winch_status_message(
        sensing.microseconds(v), winch.line, winch.line_speed, nan, nan, nan, 32767, winch.winch_status()
    )  # fmt: skip


def _terrain(v: Systems) -> Any:
    if not v.position_ok or not v.terrain.enabled:
        return None
    return v.terrain.report(v.ground_place(), v.ground_home, -v.body.d)


def _terrain_request(v: Systems) -> Any:
    return v.terrain.request(v.ground_place(), v.wall) if v.position_ok else None


def _version(v: Systems) -> Any:
    release = (4 << 24) | (7 << 16) | mav.FIRMWARE_VERSION_TYPE_DEV
    hashed, nothing = list(b"70746572"), [0] * 8
    own = list(f"twin {v.options.system}".encode().ljust(18, b"\0"))
    return mav.MAVLink_autopilot_version_message(  # ArduPilot leaves all ids but `uid2` empty
        _CAPABLE | (mav.MAV_PROTOCOL_CAPABILITY_TERRAIN if v.terrain.enabled else 0),
        release,
        0,
        0,
        0,
        hashed,
        nothing,
        nothing,
        0,
        0,
        0,
        own,
    )


MAKERS: dict[int, Callable[[Systems], Any]] = {
    mav.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mav.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    mav.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    mav.MAVLINK_MSG_ID_GPS_RAW_INT: sensing.gps,
    mav.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global,
    mav.MAVLINK_MSG_ID_VFR_HUD: _hud,
    mav.MAVLINK_MSG_ID_BATTERY_STATUS: sensing.battery,
    mav.MAVLINK_MSG_ID_RC_CHANNELS: sensing.rc,
    mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: sensing.servos,
    mav.MAVLINK_MSG_ID_RELAY_STATUS: sensing.relays,
    mav.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4: sensing.escs,
    mav.MAVLINK_MSG_ID_ADSB_VEHICLE: lambda v: v.adsb.next(v.wall),
    mav.MAVLINK_MSG_ID_RAW_IMU: sensing.raw_imu,
    mav.MAVLINK_MSG_ID_SCALED_IMU2: sensing.scaled_imu,
    mav.MAVLINK_MSG_ID_SCALED_PRESSURE: sensing.pressure,
    mav.MAVLINK_MSG_ID_HIGHRES_IMU: sensing.highres,
    mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT: _ekf,
    mav.MAVLINK_MSG_ID_VIBRATION: sensing.vibration,
    mav.MAVLINK_MSG_ID_WIND: _wind,
    mav.MAVLINK_MSG_ID_HOME_POSITION: Systems.home_position,
    mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: Systems.global_origin,
    mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _landed,
    mav.MAVLINK_MSG_ID_MISSION_CURRENT: _mission,
    mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: _controller,
    mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _target,
    mav.MAVLINK_MSG_ID_FENCE_STATUS: _fence,
    mav.MAVLINK_MSG_ID_DISTANCE_SENSOR: sensing.range_finder,
    mav.MAVLINK_MSG_ID_POWER_STATUS: sensing.power,
    mav.MAVLINK_MSG_ID_WINCH_STATUS: _winch,
    mav.MAVLINK_MSG_ID_MAG_CAL_PROGRESS: lambda v: v.calibrations.progress(),
    mav.MAVLINK_MSG_ID_MAG_CAL_REPORT: lambda _: None,  # sent when it is there
    mav.MAVLINK_MSG_ID_TERRAIN_REPORT: _terrain,
    mav.MAVLINK_MSG_ID_TERRAIN_REQUEST: _terrain_request,
    **mount_messages.MAKERS,
    mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _version,
}
"""Builders of the available messages, by id; they return None while there is no value."""
