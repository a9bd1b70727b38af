"""The sensor messages: the true state with noise."""

from __future__ import annotations

import math
from typing import Any

from rcp_mavlink_sim.body import GRAVITY
from rcp_mavlink_sim.state import VehicleState
from rcp_mavlink_sim.systems import Systems
from rcp_mavlink_sim.wire import mav

__all__ = [
    "attitude",
    "battery",
    "escs",
    "gps",
    "highres",
    "microseconds",
    "milliseconds",
    "power",
    "pressure",
    "range_finder",
    "raw_imu",
    "rc",
    "relays",
    "scaled_imu",
    "servos",
    "vibration",
]  # fmt: skip

_NOTHING = 65535
_ACCELERATION, _RATE, _FIELD, _SPEED = 0.03, 0.002, 1.5, 0.05  # m/s2, rad/s, mgauss, m/s
_DEGREE = 111_320.0  # m per degree of latitude


def milliseconds(v: VehicleState) -> int:
    """Return the time since boot, ms."""
    return round(v.time * 1000) & 0xFFFFFFFF


def microseconds(v: VehicleState) -> int:
    """Return the time since boot, µs."""
    return round(v.time * 1e6)


def gps(v: VehicleState) -> Any:
    """Return GPS_RAW_INT."""
    us, noise, b = microseconds(v), v.noise, v.body
    if not v.gps_ok:
        kind = 1 if v.params["SIM_GPS1_ENABLE"] else 0
        return mav.MAVLink_gps_raw_int_message(us, kind, 0, 0, 0, 9999, 9999, 0, 0, 0)
    lat, lon = v.geographic()
    lat += noise.slow("gps_n") / _DEGREE
    lon += noise.slow("gps_e") / _DEGREE / max(0.01, math.cos(math.radians(lat)))
    speed = abs(math.hypot(b.vn, b.ve) + noise.white(_SPEED))
    course = math.degrees(math.atan2(b.ve, b.vn)) % 360
    height = round((v.origin[2] - b.d + noise.slow("gps_d")) * 1000)
    return mav.MAVLink_gps_raw_int_message(
        us, 6, round(lat * 1e7), round(lon * 1e7), height, 121, 200,
        round(speed * 100), round(course * 100) % 36000, 10, height, 300, 300, 40,
    )  # fmt: skip


def attitude(v: VehicleState) -> tuple[float, float, float, float, float, float]:
    """Return roll, pitch, yaw and their rates as estimated by the EKF, rad and rad/s."""
    b, noise = v.body, v.noise
    return (
        b.roll + noise.slow("roll"),
        b.pitch + noise.slow("pitch"),
        math.remainder(b.yaw + noise.slow("yaw"), math.tau),
        *_rates(v),
    )


def _rates(v: VehicleState) -> tuple[float, float, float]:
    b, white = v.body, v.noise.white
    return b.p + white(_RATE), b.q + white(_RATE), b.r + white(_RATE)


def _specific(v: VehicleState) -> tuple[float, float, float]:
    """Return the specific force in the body frame, m/s2."""
    b, white = v.body, v.noise.white
    n, e, d = b.an, b.ae, b.ad - GRAVITY
    sr, cr = math.sin(b.roll), math.cos(b.roll)
    sp, cp = math.sin(b.pitch), math.cos(b.pitch)
    sy, cy = math.sin(b.yaw), math.cos(b.yaw)
    x = cp * cy * n + cp * sy * e - sp * d
    y = (sr * sp * cy - cr * sy) * n + (sr * sp * sy + cr * cy) * e + sr * cp * d
    z = (cr * sp * cy + sr * sy) * n + (cr * sp * sy - sr * cy) * e + cr * cp * d
    return x + white(_ACCELERATION), y + white(_ACCELERATION), z + white(_ACCELERATION)


def _field(v: VehicleState) -> tuple[float, float, float]:
    """Return the magnetic field in the body frame, mgauss; only the heading is considered."""
    yaw, white = v.body.yaw, v.noise.white
    return (
        230 * math.cos(yaw) + white(_FIELD),
        -230 * math.sin(yaw) + white(_FIELD),
        -530 + white(_FIELD),
    )


def _inertial(v: VehicleState) -> list[int]:
    accel = [round(a / GRAVITY * 1000) for a in _specific(v)]
    return [*accel, *(round(w * 1000) for w in _rates(v)), *(round(m) for m in _field(v))]


def raw_imu(v: VehicleState) -> Any:
    """Return RAW_IMU."""
    return mav.MAVLink_raw_imu_message(microseconds(v), *_inertial(v), 0, 4500)


def scaled_imu(v: VehicleState) -> Any:
    """Return SCALED_IMU2."""
    return mav.MAVLink_scaled_imu2_message(milliseconds(v), *_inertial(v), 4500)


def _hectopascals(v: VehicleState) -> float:
    height = v.origin[2] - v.body.d
    error = v.noise.slow("baro") + v.noise.white(0.01)
    return 1013.25 * (1 - height / 44330) ** 5.255 + error


def pressure(v: VehicleState) -> Any:
    """Return SCALED_PRESSURE."""
    return mav.MAVLink_scaled_pressure_message(milliseconds(v), _hectopascals(v), 0.0, 3500)


def highres(v: VehicleState) -> Any:
    """Return HIGHRES_IMU."""
    field = [value / 1000 for value in _field(v)]
    height = v.origin[2] - v.body.d
    return mav.MAVLink_highres_imu_message(
        microseconds(v), *_specific(v), *_rates(v), *field, _hectopascals(v), 0.0, height, 35.0, 0x1FFF
    )  # fmt: skip


def vibration(v: VehicleState) -> Any:
    """Return VIBRATION."""
    shake = 3.0 * v.body.throttle if v.armed else 0.001
    x, y, z = (abs(shake + v.noise.white(shake / 5)) for _ in range(3))
    return mav.MAVLink_vibration_message(microseconds(v), x, y, z, 0, 0, 0)


def range_finder(v: VehicleState) -> Any:
    """Return DISTANCE_SENSOR."""
    height = round(min(40.0, max(0.0, -v.body.d + v.noise.white(0.02))) * 100)
    return mav.MAVLink_distance_sensor_message(milliseconds(v), 10, 4000, height, 0, 0, 25, 0)


def battery(v: Systems) -> Any:
    """Return BATTERY_STATUS."""
    pack = v.battery
    volts = round((pack.voltage + v.noise.white(0.01)) * 1000)
    state = mav.MAV_BATTERY_CHARGE_STATE_OK
    if v.failsafes.battery_critical:
        state = mav.MAV_BATTERY_CHARGE_STATE_CRITICAL
    elif v.failsafes.battery_low:
        state = mav.MAV_BATTERY_CHARGE_STATE_LOW
    return mav.MAVLink_battery_status_message(
        0, 0, 1, 2500, [volts, *([_NOTHING] * 9)], round(pack.current * 100), round(pack.consumed),
        round(pack.consumed * pack.voltage * 0.036), round(pack.charge * 100),
        round(pack.charge * pack.capacity / max(pack.current, 0.1) * 3.6), state,
    )  # fmt: skip


def power(_: VehicleState) -> Any:
    """Return POWER_STATUS."""
    return mav.MAVLink_power_status_message(5000, 0, 0)


def rc(v: Systems) -> Any:
    """Return RC_CHANNELS."""
    lost = v.failsafes.radio_lost
    return mav.MAVLink_rc_channels_message(
        milliseconds(v), 0 if lost else 16, *v.sticks.pulses, _NOTHING, _NOTHING, 0 if lost else 255
    )


def servos(v: Systems) -> Any:
    """Return SERVO_OUTPUT_RAW."""
    pulses = dict(enumerate(v.body.pulses(armed=v.armed), 1)) | v.outputs.pulses
    pulses |= v.motor_test.pulses()
    all_ = [pulses.get(output, 0) for output in range(1, 17)]
    return mav.MAVLink_servo_output_raw_message(microseconds(v) & 0xFFFFFFFF, 0, *all_)


def escs(v: Systems) -> Any:
    """Return ESC_TELEMETRY_1_TO_4; None where the speed controllers report nothing."""
    if not v.params["SIM_ESC_TELEM"]:
        return None
    turning = [max(0, pulse - 1000) / 1000 for pulse in v.body.pulses(armed=v.armed)[:4]]
    turning += [0.0] * (4 - len(turning))
    drawn = round(v.battery.current * 100 / 4)
    return mav.MAVLink_esc_telemetry_1_to_4_message(
        [round(25 + 40 * part) for part in turning], [round(v.battery.voltage * 100)] * 4, [drawn] * 4,
        [round(v.battery.consumed / 4)] * 4, [round(9000 * part) for part in turning],
        [round(v.time * 10) % 65536 or 1] * 4,
    )  # fmt: skip


def relays(v: VehicleState) -> Any:
    """Return RELAY_STATUS."""
    return mav.MAVLink_relay_status_message(milliseconds(v), v.outputs.relays, v.outputs.present)
