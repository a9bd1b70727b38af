"""Units of well-known messages (UCUM), from REP-103 and comments: ROS definitions contain none."""

from __future__ import annotations

__all__ = ["unit_of"]

_UNITS: dict[str, dict[str, str]] = {
    "builtin_interfaces/msg/Time": {"sec": "s", "nanosec": "ns"},
    "builtin_interfaces/msg/Duration": {"sec": "s", "nanosec": "ns"},
    "geometry_msgs/msg/Point": {"*": "m"},
    "geometry_msgs/msg/Point32": {"*": "m"},
    "geometry_msgs/msg/Quaternion": {"*": "1"},
    "geometry_msgs/msg/Pose2D": {"x": "m", "y": "m", "theta": "rad"},
    "geometry_msgs/msg/Transform": {"translation": "m"},
    "geometry_msgs/msg/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/msg/Accel": {"linear": "m/s2", "angular": "rad/s2"},
    "geometry_msgs/msg/Wrench": {"force": "N", "torque": "N.m"},
    "geometry_msgs/msg/Inertia": {"m": "kg", "com": "m", "*": "kg.m2"},
    "nav_msgs/msg/MapMetaData": {"resolution": "m", "width": "1", "height": "1"},
    "nav_msgs/msg/OccupancyGrid": {"data": "%"},
    "nav_msgs/msg/GridCells": {"cell_width": "m", "cell_height": "m"},
    "sensor_msgs/msg/BatteryState": {
        "voltage": "V",
        "temperature": "Cel",
        "current": "A",
        "charge": "A.h",
        "capacity": "A.h",
        "design_capacity": "A.h",
        "percentage": "1",
        "cell_voltage": "V",
        "cell_temperature": "Cel",
    },
    "sensor_msgs/msg/FluidPressure": {"fluid_pressure": "Pa", "variance": "Pa2"},
    "sensor_msgs/msg/Illuminance": {"illuminance": "lx", "variance": "lx2"},
    "sensor_msgs/msg/Image": {"width": "1", "height": "1", "step": "By"},
    "sensor_msgs/msg/Imu": {
        "orientation_covariance": "rad2",
        "angular_velocity": "rad/s",
        "angular_velocity_covariance": "rad2/s2",
        "linear_acceleration": "m/s2",
        "linear_acceleration_covariance": "m2/s4",
    },
    "sensor_msgs/msg/Joy": {"axes": "1", "buttons": "1"},
    "sensor_msgs/msg/LaserScan": {
        "angle_min": "rad",
        "angle_max": "rad",
        "angle_increment": "rad",
        "time_increment": "s",
        "scan_time": "s",
        "range_min": "m",
        "range_max": "m",
        "ranges": "m",
        "intensities": "1",
    },
    "sensor_msgs/msg/MagneticField": {"magnetic_field": "T", "magnetic_field_covariance": "T2"},
    "sensor_msgs/msg/NavSatFix": {
        "latitude": "deg",
        "longitude": "deg",
        "altitude": "m",
        "position_covariance": "m2",
    },
    "sensor_msgs/msg/PointCloud2": {
        "width": "1",
        "height": "1",
        "point_step": "By",
        "row_step": "By",
    },
    "sensor_msgs/msg/Range": {
        "field_of_view": "rad",
        "min_range": "m",
        "max_range": "m",
        "range": "m",
        "variance": "m2",
    },
    "sensor_msgs/msg/RelativeHumidity": {"relative_humidity": "1", "variance": "1"},
    "sensor_msgs/msg/Temperature": {"temperature": "Cel", "variance": "K2"},
}


def unit_of(message: str, field: str) -> str | None:
    """Return the unit of a field, or of every number inside it; None if it is unknown."""
    table = _UNITS.get(message)
    return None if table is None else table.get(field, table.get("*"))
