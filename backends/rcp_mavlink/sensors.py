"""Which message stands at which path, by the kind of autopilot."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import NamedTuple

from rcp_mavlink.dialect import Dialect

__all__ = ["BASE", "ESTIMATOR", "Sensor", "sensors"]


class Sensor(NamedTuple):
    """A path and the message that is its value."""

    name: str
    message: str
    description: str
    live: bool = False
    """It comes whether anybody watches or not: the gateway needs it itself."""


_SENSORS = (
    Sensor("sensor/attitude", "ATTITUDE", "Roll, pitch and yaw with their rates; forward, right, down."),
    Sensor("sensor/position/global", "GLOBAL_POSITION_INT", "Where it is by the estimator: degrees, height over the sea and over home, velocity north, east, down.", live=True),
    Sensor("sensor/position/local", "LOCAL_POSITION_NED", "Metres and velocity north, east and down of the estimator's origin."),
    Sensor("sensor/velocity", "VFR_HUD", "Speed over ground and through the air, climb, heading and throttle."),
    Sensor("sensor/gps", "GPS_RAW_INT", "What the GPS receiver says: fix, satellites, accuracy."),
    Sensor("sensor/battery", "BATTERY_STATUS", "Voltage of the cells, current, charge left."),
    Sensor("sensor/rc", "RC_CHANNELS", "The sticks and switches of the transmitter, as pulses."),
    Sensor("sensor/rangefinder", "DISTANCE_SENSOR", "Distance measured by the range finder."),
    Sensor("sensor/health", "SYS_STATUS", "Sensors present, enabled and healthy as bits; load, battery.", live=True),
    Sensor("sensor/landed", "EXTENDED_SYS_STATE", "Whether it stands, takes off, flies or lands.", live=True),
    Sensor("sensor/home", "HOME_POSITION", "Where home is."),
    Sensor("sensor/mission", "MISSION_CURRENT", "The item that is flown, of how many, and the state of the mission.", live=True),
    Sensor("sensor/servos", "SERVO_OUTPUT_RAW", "What the servos and motors are told, as pulses."),
    Sensor("sensor/vibration", "VIBRATION", "Vibration, and how often the accelerometers clipped."),
    Sensor("sensor/navigation", "NAV_CONTROLLER_OUTPUT", "Where the controller steers to, and how far it is off."),
    Sensor("sensor/fence", "FENCE_STATUS", "Whether the geofence was crossed, how often and which."),
)  # fmt: skip
_ARDUPILOT = (
    Sensor("sensor/imu", "RAW_IMU", "Acceleration, turning rate and magnetic field."),
    Sensor("sensor/ekf", "EKF_STATUS_REPORT", "What the estimator is sure of: flags and variances."),
    Sensor("sensor/wind", "WIND", "Where the wind comes from, and how fast."),
    Sensor("sensor/gimbal", "MOUNT_STATUS", "Where the camera looks, in hundredths of a degree."),
)  # fmt: skip
_PX4 = (
    Sensor("sensor/imu", "HIGHRES_IMU", "Acceleration, turning rate, magnetic field, pressure."),
    Sensor("sensor/ekf", "ESTIMATOR_STATUS", "What the estimator is sure of: flags and ratios."),
    Sensor("sensor/wind", "WIND_COV", "The wind, north, east and down."),
    Sensor("sensor/gimbal", "GIMBAL_DEVICE_ATTITUDE_STATUS", "Where the camera looks, as a quaternion."),
)  # fmt: skip

BASE = ("GLOBAL_POSITION_INT", "EXTENDED_SYS_STATE", "SYS_STATUS", "MISSION_CURRENT")
"""Messages that the gateway needs itself."""

ESTIMATOR = "EKF_STATUS_REPORT"
"""Of an ArduPilot, likewise: it sends positions also while it has none."""


def sensors(dialect: Dialect, patterns: tuple[str, ...], *, px4: bool) -> list[Sensor]:
    """Return what stands in the tree: the usual ones, and what the configuration names."""
    usual = [*_SENSORS, *(_PX4 if px4 else _ARDUPILOT)]
    found = [sensor for sensor in usual if sensor.message in dialect.by_name]
    for name, definition in sorted(dialect.by_name.items()):
        if any(fnmatchcase(name, pattern.upper()) for pattern in patterns):
            description = definition.description
            found.append(Sensor(f"sensor/message/{name.lower()}", name, description))
    return found
