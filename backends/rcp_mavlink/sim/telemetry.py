"""The messages that tell how it is: each made when it is due or asked for."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rcp_mavlink.sim.body import GRAVITY
from rcp_mavlink.sim.wire import mav

if TYPE_CHECKING:
    from rcp_mavlink.sim.vehicle import Vehicle

__all__ = ["MAKERS", "heartbeat"]

_SENSORS = 1 | 2 | 4 | 8 | 32 | 1024 | 2048 | 4096 | 8192 | 16384 | 32768 | 65536 | 2097152
_PREARM = mav.MAV_SYS_STATUS_PREARM_CHECK
_CAPABLE = (
    mav.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mav.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mav.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mav.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mav.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
)
_NOTHING = 65535


def _ms(v: Vehicle) -> int:
    return round(v.time * 1000) & 0xFFFFFFFF


def _us(v: Vehicle) -> int:
    return round(v.time * 1e6)


def heartbeat(v: Vehicle) -> Any:
    """Return the HEARTBEAT."""
    mode = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    mode |= mav.MAV_MODE_FLAG_STABILIZE_ENABLED
    mode |= mav.MAV_MODE_FLAG_SAFETY_ARMED if v.armed else 0
    state = mav.MAV_STATE_ACTIVE if v.armed and not v.body.landed else mav.MAV_STATE_STANDBY
    return mav.MAVLink_heartbeat_message(
        mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, v.flight.mode, state, 3
    )


def _sys_status(v: Vehicle) -> Any:
    health = _SENSORS & ~(0 if v.time > 1 else 32)
    present = _SENSORS | _PREARM
    health |= _PREARM if v.ready else 0
    battery = v.battery
    return mav.MAVLink_sys_status_message(
        present, present, health, 250, round(battery.voltage * 1000), round(battery.current * 100),
        round(battery.charge * 100), 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


def _gps(v: Vehicle) -> Any:
    fixed = v.time >= min(5.0, v.options.warmup / 4)
    if not fixed:
        return mav.MAVLink_gps_raw_int_message(_us(v), 1, 0, 0, 0, 9999, 9999, 0, 0, 0)
    lat, lon = v.geographic()
    b = v.body
    speed = math.hypot(b.vn, b.ve)
    course = math.degrees(math.atan2(b.ve, b.vn)) % 360
    height = v.origin[2] - b.d
    return mav.MAVLink_gps_raw_int_message(
        _us(v), 6, round(lat * 1e7), round(lon * 1e7), round(height * 1000), 121, 200,
        round(speed * 100), round(course * 100) % 36000, 10, round(height * 1000), 300, 300, 40,
    )  # fmt: skip


def _attitude(v: Vehicle) -> Any:
    b = v.body
    return mav.MAVLink_attitude_message(_ms(v), b.roll, b.pitch, b.yaw, b.p, b.q, b.r)


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return w, x, y, z."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _attitude_quaternion(v: Vehicle) -> Any:
    b = v.body
    w, x, y, z = quaternion(b.roll, b.pitch, b.yaw)
    return mav.MAVLink_attitude_quaternion_message(_ms(v), w, x, y, z, b.p, b.q, b.r)


def _local(v: Vehicle) -> Any:
    if not v.position_ok:
        return None
    b = v.body
    return mav.MAVLink_local_position_ned_message(_ms(v), b.n, b.e, b.d, b.vn, b.ve, b.vd)


def _global(v: Vehicle) -> Any:
    b = v.body
    lat, lon = v.geographic() if v.position_ok else (0.0, 0.0)
    height = v.origin[2] - b.d
    over_home = height - (v.home or v.origin)[2]
    heading = round(math.degrees(b.yaw) % 360 * 100) % 36000
    return mav.MAVLink_global_position_int_message(
        _ms(v), round(lat * 1e7), round(lon * 1e7), round(height * 1000), round(over_home * 1000),
        round(b.vn * 100), round(b.ve * 100), round(b.vd * 100), heading,
    )  # fmt: skip


def _hud(v: Vehicle) -> Any:
    b = v.body
    speed = math.hypot(b.vn, b.ve)
    air = math.hypot(b.vn - b.wind_n, b.ve - b.wind_e)
    heading = round(math.degrees(b.yaw)) % 360
    return mav.MAVLink_vfr_hud_message(
        air, speed, heading, round(b.throttle * 100), v.origin[2] - b.d, -b.vd
    )


def _battery(v: Vehicle) -> Any:
    battery = v.battery
    cells = [round(battery.voltage * 1000), *([_NOTHING] * 9)]
    return mav.MAVLink_battery_status_message(
        0, 0, 1, 2500, cells, round(battery.current * 100), round(battery.consumed),
        round(battery.consumed * battery.voltage * 0.036), round(battery.charge * 100),
        round(battery.charge * battery.capacity / max(battery.current, 0.1) * 3.6),
        2 if v.battery_low else 1,
    )  # fmt: skip


def _rc(v: Vehicle) -> Any:
    return mav.MAVLink_rc_channels_message(
        _ms(v), 8, *([1500] * 8), *([_NOTHING] * 10), 255
    )  # fmt: skip


def _servos(v: Vehicle) -> Any:
    if not v.armed:
        pulses = [1000] * 4
    else:
        pulses = [round(1000 + 1000 * max(m, 0.1)) for m in v.body.motors()]
    return mav.MAVLink_servo_output_raw_message(_us(v) & 0xFFFFFFFF, 0, *pulses, 0, 0, 0, 0)


def _specific(v: Vehicle) -> tuple[float, float, float]:
    """Return what the accelerometers feel, m/s2 in the axes of the body."""
    b = v.body
    n, e, d = b.an, b.ae, b.ad - GRAVITY
    sr, cr = math.sin(b.roll), math.cos(b.roll)
    sp, cp = math.sin(b.pitch), math.cos(b.pitch)
    sy, cy = math.sin(b.yaw), math.cos(b.yaw)
    x = cp * cy * n + cp * sy * e - sp * d
    y = (sr * sp * cy - cr * sy) * n + (sr * sp * sy + cr * cy) * e + sr * cp * d
    z = (cr * sp * cy + sr * sy) * n + (cr * sp * sy - sr * cy) * e + cr * cp * d
    return x, y, z


def _field(v: Vehicle) -> tuple[int, int, int]:
    """Return the magnetic field in the axes of the body, mgauss; level ones of heading only."""
    yaw = v.body.yaw
    return round(230 * math.cos(yaw)), round(-230 * math.sin(yaw)), -530


def _imu(v: Vehicle) -> Any:
    b = v.body
    accel = [round(a / GRAVITY * 1000) for a in _specific(v)]
    gyro = [round(w * 1000) for w in (b.p, b.q, b.r)]
    return mav.MAVLink_raw_imu_message(_us(v), *accel, *gyro, *_field(v), 0, 4500)


def _scaled_imu(v: Vehicle) -> Any:
    b = v.body
    accel = [round(a / GRAVITY * 1000) for a in _specific(v)]
    gyro = [round(w * 1000) for w in (b.p, b.q, b.r)]
    return mav.MAVLink_scaled_imu2_message(_ms(v), *accel, *gyro, *_field(v), 4500)


def _pressure(v: Vehicle) -> Any:
    height = v.origin[2] - v.body.d
    pressure = 1013.25 * (1 - height / 44330) ** 5.255
    return mav.MAVLink_scaled_pressure_message(_ms(v), pressure, 0.0, 3500)


def _highres(v: Vehicle) -> Any:
    b = v.body
    height = v.origin[2] - b.d
    pressure = 1013.25 * (1 - height / 44330) ** 5.255
    field = [value / 1000 for value in _field(v)]
    return mav.MAVLink_highres_imu_message(
        _us(v), *_specific(v), b.p, b.q, b.r, *field, pressure, 0.0, height, 35.0, 0x1FFF
    )


def _ekf(v: Vehicle) -> Any:
    flags = 1 | 2 | 4 | 8 | 16 | 32 | 512 if v.position_ok else 1 | 4 | 32 | 128
    return mav.MAVLink_ekf_status_report_message(flags, 0.02, 0.02, 0.01, 0.03, 0.0)


def _vibration(v: Vehicle) -> Any:
    shake = 3.0 * v.body.throttle if v.armed else 0.001
    return mav.MAVLink_vibration_message(_us(v), shake, shake, shake, 0, 0, 0)


def _wind(v: Vehicle) -> Any:
    n, e = v.body.wind_n, v.body.wind_e
    return mav.MAVLink_wind_message(math.degrees(math.atan2(-e, -n)), math.hypot(n, e), 0.0)


def _home(v: Vehicle) -> Any:
    if v.home is None:
        return None
    n, e = v.home_place()
    return mav.MAVLink_home_position_message(
        round(v.home[0] * 1e7), round(v.home[1] * 1e7), round(v.home[2] * 1000), n, e,
        v.origin[2] - v.home[2], [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, _us(v),
    )  # fmt: skip


def _origin(v: Vehicle) -> Any:
    if not v.position_ok:
        return None
    lat, lon, height = v.origin
    return mav.MAVLink_gps_global_origin_message(
        round(lat * 1e7), round(lon * 1e7), round(height * 1000), _us(v)
    )


def _landed(v: Vehicle) -> Any:
    if v.body.landed:
        state = mav.MAV_LANDED_STATE_ON_GROUND
    elif v.flight.taking_off:
        state = mav.MAV_LANDED_STATE_TAKEOFF
    elif v.flight.landing:
        state = mav.MAV_LANDED_STATE_LANDING
    else:
        state = mav.MAV_LANDED_STATE_IN_AIR
    return mav.MAVLink_extended_sys_state_message(0, state)


def _mission(v: Vehicle) -> Any:
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


def _controller(v: Vehicle) -> Any:
    b, pilot = v.body, v.pilot
    n, e = pilot.place or (b.n, b.e)
    bearing = round(math.degrees(math.atan2(e - b.e, n - b.n)))
    depth = b.d if pilot.depth is None else pilot.depth
    return mav.MAVLink_nav_controller_output_message(
        math.degrees(b.want_roll), math.degrees(b.want_pitch), bearing, bearing,
        min(65535, round(math.hypot(n - b.n, e - b.e))), b.d - depth, 0.0, 0.0,
    )  # fmt: skip


def _target(v: Vehicle) -> Any:
    pilot = v.pilot
    n, e = pilot.place or (v.body.n, v.body.e)
    depth = v.body.d if pilot.depth is None else pilot.depth
    vn, ve = pilot.velocity
    return mav.MAVLink_position_target_local_ned_message(
        _ms(v), 1, 0x0DC0, n, e, depth, vn, ve, pilot.sinking, 0, 0, 0, pilot.yaw, pilot.yaw_rate
    )


def _fence(v: Vehicle) -> Any:
    kinds = {0: 0, 1: 2, 2: 3, 4: 3, 8: 1}
    kind = next((kinds[bit] for bit in (1, 2, 4, 8) if v.fence.breached & bit), 0)
    return mav.MAVLink_fence_status_message(
        int(bool(v.fence.breached)), v.fence.count, kind, _ms(v), 0
    )


def _range(v: Vehicle) -> Any:
    height = round(min(40.0, -v.body.d) * 100)
    return mav.MAVLink_distance_sensor_message(_ms(v), 10, 4000, height, 0, 0, 25, 0)


def _power(_: Vehicle) -> Any:
    return mav.MAVLink_power_status_message(5000, 0, 0)


def _system_time(v: Vehicle) -> Any:
    return mav.MAVLink_system_time_message(round(time.time() * 1e6), _ms(v))


def _mount(v: Vehicle) -> Any:
    roll, pitch, yaw = (round(a * 100) for a in v.gimbal)
    return mav.MAVLink_mount_status_message(0, 0, pitch, roll, yaw)


def _version(v: Vehicle) -> Any:
    release = (4 << 24) | (7 << 16) | mav.FIRMWARE_VERSION_TYPE_DEV
    nothing = [0] * 8
    return mav.MAVLink_autopilot_version_message(
        _CAPABLE, release, 0, 0, 0, nothing, nothing, nothing, 0, 0, v.options.system
    )


MAKERS: dict[int, Callable[[Vehicle], Any]] = {
    mav.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mav.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    mav.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    mav.MAVLINK_MSG_ID_GPS_RAW_INT: _gps,
    mav.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global,
    mav.MAVLINK_MSG_ID_VFR_HUD: _hud,
    mav.MAVLINK_MSG_ID_BATTERY_STATUS: _battery,
    mav.MAVLINK_MSG_ID_RC_CHANNELS: _rc,
    mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: _servos,
    mav.MAVLINK_MSG_ID_RAW_IMU: _imu,
    mav.MAVLINK_MSG_ID_SCALED_IMU2: _scaled_imu,
    mav.MAVLINK_MSG_ID_SCALED_PRESSURE: _pressure,
    mav.MAVLINK_MSG_ID_HIGHRES_IMU: _highres,
    mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT: _ekf,
    mav.MAVLINK_MSG_ID_VIBRATION: _vibration,
    mav.MAVLINK_MSG_ID_WIND: _wind,
    mav.MAVLINK_MSG_ID_HOME_POSITION: _home,
    mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _origin,
    mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _landed,
    mav.MAVLINK_MSG_ID_MISSION_CURRENT: _mission,
    mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: _controller,
    mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _target,
    mav.MAVLINK_MSG_ID_FENCE_STATUS: _fence,
    mav.MAVLINK_MSG_ID_DISTANCE_SENSOR: _range,
    mav.MAVLINK_MSG_ID_POWER_STATUS: _power,
    mav.MAVLINK_MSG_ID_MOUNT_STATUS: _mount,
    mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _version,
}
"""What can be sent regularly or on request, by message id; None of a maker: not known yet."""
