"""The message behind each path, by the kind of autopilot; `derived` has those of the profiles."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import NamedTuple

from rcp_mavlink.dialect import Dialect

__all__ = ["BASE", "ESTIMATOR", "Sensor", "sensors"]


class Sensor(NamedTuple):
    """A path and the message with its value."""

    name: str
    message: str
    description: str
    live: bool = False
    """Whether the gateway itself needs it, so that it is always received."""


_SENSORS = (
    Sensor("sensor/attitude", "ATTITUDE", "Roll, pitch and yaw with their rates; forward, right, down."),
    Sensor("sensor/position/global", "GLOBAL_POSITION_INT", "Estimated position: degrees, height above sea level and above home, velocity north, east, down.", live=True),
    Sensor("sensor/position/local", "LOCAL_POSITION_NED", "Estimated position in metres and velocity, north, east and down from the estimator's origin."),
    Sensor("sensor/gps", "GPS_RAW_INT", "GPS receiver: fix, satellites, accuracy."),
    Sensor("sensor/rc", "RC_CHANNELS", "Sticks and switches of the transmitter, as pulse widths."),
    Sensor("sensor/rangefinder", "DISTANCE_SENSOR", "Distance measured by the range finder."),
    Sensor("sensor/health", "SYS_STATUS", "Sensors present, enabled and healthy as bits; load, battery.", live=True),
    Sensor("sensor/landed", "EXTENDED_SYS_STATE", "Landed state: on the ground, taking off, in the air or landing.", live=True),
    Sensor("sensor/home", "HOME_POSITION", "Home position."),
    Sensor("sensor/mission", "MISSION_CURRENT", "Current mission item, number of items, and state of the mission.", live=True),
    Sensor("sensor/servos", "SERVO_OUTPUT_RAW", "Outputs to servos and motors, as pulse widths."),
    Sensor("sensor/vibration", "VIBRATION", "Vibration, and clipping counts of the accelerometers."),
    Sensor("sensor/navigation", "NAV_CONTROLLER_OUTPUT", "Target of the navigation controller, and its errors."),
    Sensor("sensor/origin", "GPS_GLOBAL_ORIGIN", "Origin of the estimator, from which the frame `local` is measured."),
    Sensor("sensor/winch", "WINCH_STATUS", "Line that is out, its speed and tension, and the state of the winch."),
    Sensor("sensor/fence", "FENCE_STATUS", "Geofence breaches: state, count and type."),
)  # fmt: skip
_ARDUPILOT = (
    Sensor("sensor/imu", "RAW_IMU", "Acceleration, angular rate and magnetic field."),
    Sensor("sensor/ekf", "EKF_STATUS_REPORT", "Status of the estimator: flags and variances."),
    Sensor("sensor/wind", "WIND", "Wind direction (where it comes from) and speed."),
    Sensor("sensor/gimbal", "MOUNT_STATUS", "Direction of the camera, in hundredths of a degree."),
)  # fmt: skip
_PX4 = (
    Sensor("sensor/imu", "HIGHRES_IMU", "Acceleration, angular rate, magnetic field, pressure."),
    Sensor("sensor/ekf", "ESTIMATOR_STATUS", "Status of the estimator: flags and ratios."),
    Sensor("sensor/wind", "WIND_COV", "The wind, north, east and down."),
    Sensor("sensor/gimbal", "GIMBAL_DEVICE_ATTITUDE_STATUS", "Direction of the camera, as a quaternion."),
)  # fmt: skip

BASE = ("GLOBAL_POSITION_INT", "EXTENDED_SYS_STATE", "SYS_STATUS", "MISSION_CURRENT")
"""Messages that the gateway itself needs."""

ESTIMATOR = "EKF_STATUS_REPORT"
"""Needed from an ArduPilot as well: it sends positions even while it has none."""


def sensors(dialect: Dialect, patterns: tuple[str, ...], *, px4: bool) -> list[Sensor]:
    """Return the sensors in the tree: the standard ones, and those of the configuration."""
    usual = [*_SENSORS, *(_PX4 if px4 else _ARDUPILOT)]
    found = [sensor for sensor in usual if sensor.message in dialect.by_name]
    for name, definition in sorted(dialect.by_name.items()):
        if any(fnmatchcase(name, pattern.upper()) for pattern in patterns):
            description = definition.description
            found.append(Sensor(f"sensor/message/{name.lower()}", name, description))
    return found
