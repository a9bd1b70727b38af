"""Which resource of a robot is which ROS topic, in both directions, as data.

Names are relative to the robot: `odom` is `/odom` of a tenant's only robot, and `/r1/odom` of its
robot `r1`. Where several entries have one name, the first whose resource exists and has the fields
that it needs is the topic.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rcp_ros_messages.message_type import zero
from rcp_ros_messages.source import (
    Source,
    Take,
    at,
    beside,
    constant,
    constant_list,
    first,
    real,
    stamp,
)

__all__ = ["ACTIONS", "COMMANDS", "TOPICS", "ActionMapping", "Command", "Topic"]

_CHARGING, _DISCHARGING = 1, 2
_FIX = {"none": -1, "2d": 0, "3d": 0, "dgnss": 1, "rtk_float": 2, "rtk_fixed": 2}
_GPS = 1
_APPROXIMATED = 1
_ABSENT = constant_list(-1.0, *[0.0] * 8)  # a covariance that begins with -1: no such measurement


@dataclass(frozen=True, slots=True)
class Topic:
    """A message made of the values of a resource."""

    name: str
    type: str
    source: str
    """Name of the resource."""
    fields: Mapping[str, Take]
    """What each field of the message is taken from; the others keep their zeros."""
    needs: tuple[str, ...] = ()
    """Fields that a value of the resource must have."""
    beside: str | None = None
    """Name of a second resource, whose newest value goes into the same message."""

    def message(self, source: Source) -> dict[str, Any]:
        """Return the message of a value."""
        message = zero(self.type)
        for path, take in self.fields.items():
            value = take(source)
            if value is not None:
                put(message, path, value)
        return message


@dataclass(frozen=True, slots=True)
class Command:
    """A topic whose messages command a resource: written to an actuator, executed as a goal."""

    name: str
    type: str
    target: str
    """Name of the resource."""
    fields: Mapping[str, Take]
    """What each field of the value is taken from, in the message."""
    same: bool = False
    """Whether a message of the type is the value as it is."""

    def value(self, message: Any) -> dict[str, Any]:
        """Return the value of a message."""
        return _built(self.fields, message)


@dataclass(frozen=True, slots=True)
class ActionMapping:
    """A ROS action that is an action of the tree."""

    name: str
    type: str
    target: str
    goal: Mapping[str, Take]
    feedback: Mapping[str, Take]
    result: Mapping[str, Take]

    def to_goal(self, args: Any) -> dict[str, Any]:
        """Return the input of the action for a goal."""
        return _built(self.goal, args)

    def to_feedback(self, value: Any) -> dict[str, Any]:
        """Return the feedback message of a feedback value."""
        return _built(self.feedback, value)

    def to_result(self, value: Any) -> dict[str, Any]:
        """Return the result message of a result."""
        return _built(self.result, value)


def put(message: dict[str, Any], path: str, value: Any) -> None:
    """Set a field by its dotted path; objects on the way are made."""
    *names, last = path.split(".")
    for name in names:
        message = message.setdefault(name, {})
    message[last] = value


def _built(fields: Mapping[str, Take], value: Any) -> dict[str, Any]:
    source, out = Source(value, {}), dict[str, Any]()
    for path, take in fields.items():
        found = take(source)
        if found is not None:
            put(out, path, found)
    return out


def _charging(source: Source) -> int | None:
    charging = source.value.get("charging")
    if charging is None:
        return None
    return _CHARGING if charging else _DISCHARGING


def _angle_max(source: Source) -> float:
    value = source.value
    return value["angle_min"] + value["angle_increment"] * max(0, len(value["ranges"]) - 1)


def _fix(source: Source) -> int:
    return _FIX.get(source.value.get("fix"), -1)


def _position_covariance(source: Source) -> list[float] | None:
    accuracy = source.value.get("horizontal_accuracy")
    if accuracy is None:
        return None
    square = accuracy * accuracy
    return [square, 0.0, 0.0, 0.0, square, 0.0, 0.0, 0.0, 4 * square]


def _covariance_type(source: Source) -> int | None:
    return None if source.value.get("horizontal_accuracy") is None else _APPROXIMATED


def _cells(source: Source) -> list[int]:
    """Return the cells of a map: bytes above 127 are negative."""
    return [cell - 256 if cell > 127 else cell for cell in source.value["data"]]


def _yaw(path: str) -> Take:
    take = at(path)

    def found(source: Source) -> float | None:
        q = take(source)
        if not isinstance(q, dict):
            return None
        x, y, z, w = (float(q.get(name) or 0.0) for name in "xyzw")  # pyright: ignore[reportUnknownMemberType,reportUnknownArgumentType]
        if not (x or y or z or w):  # a message whose orientation nobody has set
            return None
        return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    return found


def _frame(path: str) -> Take:
    take = at(path)
    return lambda source: take(source) or None


_HEADER = {"header.stamp": stamp, "header.frame_id": at("frame_id")}
_JOINTS = {name: at(name) for name in ("name", "position", "velocity", "effort")}
_CLOUD = ("height", "width", "fields", "is_bigendian", "point_step", "row_step", "data", "is_dense")
_SCAN = ("angle_min", "angle_increment", "range_min", "range_max", "ranges")

TOPICS: tuple[Topic, ...] = (
    Topic(
        "odom",
        "nav_msgs/msg/Odometry",
        "sensor/pose",
        {
            **_HEADER,
            "child_frame_id": constant("base_link"),
            "pose.pose.position": at("position"),
            "pose.pose.orientation": at("orientation"),
            "twist.twist.linear": beside("linear"),
            "twist.twist.angular": beside("angular"),
        },
        needs=("position", "orientation"),
        beside="sensor/velocity",
    ),
    Topic(
        "pose",
        "geometry_msgs/msg/PoseStamped",
        "sensor/pose",
        {**_HEADER, "pose.position": at("position"), "pose.orientation": at("orientation")},
        needs=("position", "orientation"),
    ),
    Topic(
        "velocity",
        "geometry_msgs/msg/TwistStamped",
        "sensor/velocity",
        {**_HEADER, "twist.linear": at("linear"), "twist.angular": at("angular")},
        needs=("linear", "angular"),
    ),
    Topic(
        "imu/data",
        "sensor_msgs/msg/Imu",
        "sensor/imu",
        {
            **_HEADER,
            "orientation": at("orientation"),
            "angular_velocity": at("angular_velocity"),
            "linear_acceleration": at("linear_acceleration"),
        },
        needs=("orientation", "angular_velocity", "linear_acceleration"),
    ),
    Topic(
        "imu/data",
        "sensor_msgs/msg/Imu",
        "sensor/orientation",
        {
            "header.stamp": stamp,
            "header.frame_id": constant("base_link"),
            "orientation": at("orientation"),
            "angular_velocity": at("angular_velocity"),
            "linear_acceleration_covariance": _ABSENT,
        },
        needs=("orientation", "angular_velocity"),
    ),
    Topic(
        "battery_state",
        "sensor_msgs/msg/BatteryState",
        "sensor/battery",
        {
            "header.stamp": stamp,
            "voltage": real("voltage"),
            "current": real("current"),
            "percentage": real("percentage"),
            "temperature": real("temperature"),
            "charge": real("charge"),
            "capacity": real("capacity"),
            "design_capacity": real("design_capacity"),
            "power_supply_status": _charging,
            "present": constant(value=True),
        },
        needs=("percentage", "voltage"),
    ),
    Topic(
        "scan",
        "sensor_msgs/msg/LaserScan",
        "sensor/scan",
        {**_HEADER, "angle_max": _angle_max, **{name: at(name) for name in _SCAN}},
        needs=_SCAN,
    ),
    Topic(
        "joint_states",
        "sensor_msgs/msg/JointState",
        "sensor/joint_states",
        {"header.stamp": stamp, **_JOINTS},
        needs=("name", "position"),
    ),
    Topic(
        "fix",
        "sensor_msgs/msg/NavSatFix",
        "sensor/gnss",
        {
            "header.stamp": stamp,
            "header.frame_id": constant("gps"),
            "status.status": _fix,
            "status.service": constant(_GPS),
            "latitude": real("latitude"),
            "longitude": real("longitude"),
            "altitude": real("altitude"),
            "position_covariance": _position_covariance,
            "position_covariance_type": _covariance_type,
        },
        needs=("fix", "latitude", "longitude"),
    ),
    Topic(
        "camera/image/compressed",
        "sensor_msgs/msg/CompressedImage",
        "sensor/camera",
        {**_HEADER, "format": at("format"), "data": at("data")},
        needs=("format", "data"),
    ),
    Topic(
        "map",
        "nav_msgs/msg/OccupancyGrid",
        "sensor/map",
        {
            **_HEADER,
            "info.map_load_time": stamp,
            "info.resolution": at("resolution"),
            "info.width": at("width"),
            "info.height": at("height"),
            "info.origin": at("origin"),
            "data": _cells,
        },
        needs=("resolution", "width", "height", "origin", "data"),
    ),
    Topic(
        "points",
        "sensor_msgs/msg/PointCloud2",
        "sensor/points",
        {
            "header.stamp": stamp,
            "header.frame_id": at("header.frame_id"),
            **{name: at(name) for name in _CLOUD},
        },
        needs=("fields", "point_step", "data"),
    ),
    Topic(
        "tf",
        "tf2_msgs/msg/TFMessage",
        "sensor/transforms",
        {"transforms": at("transforms")},
        needs=("transforms",),
    ),
    Topic("robot_description", "std_msgs/msg/String", "param/robot_description", {"data": at("")}),
)

COMMANDS: tuple[Command, ...] = (
    Command(
        "cmd_vel",
        "geometry_msgs/msg/Twist",
        "actuator/cmd_vel",
        {"linear": first("linear", "twist.linear"), "angular": first("angular", "twist.angular")},
        same=True,
    ),
    Command(
        "goal_pose",
        "geometry_msgs/msg/PoseStamped",
        "action/move_to",
        {
            "position": at("pose.position"),
            "frame": _frame("header.frame_id"),
            "yaw": _yaw("pose.orientation"),
        },
    ),
)

ACTIONS: tuple[ActionMapping, ...] = (
    ActionMapping(
        "navigate_to_pose",
        "nav2_msgs/action/NavigateToPose",
        "action/move_to",
        goal={
            "position": at("pose.pose.position"),
            "frame": _frame("pose.header.frame_id"),
            "yaw": _yaw("pose.pose.orientation"),
        },
        feedback={
            "distance_remaining": at("distance_remaining"),
            "number_of_recoveries": constant(0),
        },
        result={"error_code": constant(0), "error_msg": constant("")},
    ),
)
