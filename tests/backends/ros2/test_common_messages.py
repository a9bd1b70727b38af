"""The common messages are those of ROS 2: the same fields, and the same bytes."""

from __future__ import annotations

import importlib
import math
from typing import Any

import pytest
from rclpy.serialization import deserialize_message

from rcp_ros_messages import TOPICS, MessageType, Source, encode_cdr, message_type, zero
from rcp_ros_messages.definitions import DEFINITIONS


def imported(name: str) -> Any:
    """Return ROS's own class of a type; skip where its package is not installed."""
    package, _, kind = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except ImportError:
        pytest.skip(f"{package} is not installed")


@pytest.mark.parametrize("name", sorted(DEFINITIONS))
def test_the_fields_are_those_of_the_type(name: str) -> None:
    found = message_type(name)
    assert found is not None
    own = {field: _spelled(type_) for field, type_ in _fields(found)}
    theirs = {
        f: t
        for f, t in imported(name).get_fields_and_field_types().items()
        if f != "structure_needs_at_least_one_member"
    }
    assert own == theirs


def _fields(type_: MessageType) -> list[tuple[str, str]]:
    out: list[tuple[str, str]] = []
    for field in type_.fields:
        one = field.type.replace("/msg/", "/")
        if field.length == 0:
            one = f"sequence<{one}>"
        elif field.length is not None:
            one = f"{one}[{field.length}]"
        out.append((field.name, one))
    return out


def _spelled(type_: str) -> str:
    for name, other in (("bool", "boolean"), ("float64", "double"), ("float32", "float")):
        type_ = type_.replace(name, other)
    return type_


@pytest.mark.parametrize("name", sorted(DEFINITIONS))
def test_an_empty_message_is_read_by_ros(name: str) -> None:
    cls = imported(name)
    assert deserialize_message(encode_cdr(name, zero(name)), cls) == cls_zero(cls)


def cls_zero(cls: Any) -> Any:
    """Return a message of zeros: ROS's own defaults differ (the `w` of a quaternion)."""
    message = cls()
    for field, type_ in cls.get_fields_and_field_types().items():
        value = getattr(message, field)
        if hasattr(value, "get_fields_and_field_types"):
            setattr(message, field, cls_zero(type(value)))
        elif type_ in ("double", "float"):
            setattr(message, field, 0.0)
        elif type_.startswith(("int", "uint")):
            setattr(message, field, 0)
    return message


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: f"{topic.name} of {topic.source}")
def test_messages_of_values_are_read_by_ros(topic: Any) -> None:
    value = VALUES[topic.source]
    message = topic.message(
        Source(value, {"sec": 5, "nanosec": 7}, {"linear": VECTOR, "angular": VECTOR})
    )
    read = deserialize_message(encode_cdr(topic.type, message), imported(topic.type))
    if hasattr(read, "header"):
        assert (read.header.stamp.sec, read.header.stamp.nanosec) == (5, 7)
    if topic.name == "odom":
        assert read.twist.twist.linear.y == 0.5
        assert read.pose.pose.position.x == 1.5
        assert read.child_frame_id == "base_link"
    if topic.name == "scan":
        assert read.angle_max == pytest.approx(0.2)
        assert math.isinf(read.ranges[1])
    if topic.name == "battery_state":
        assert math.isnan(read.temperature)
        assert read.percentage == pytest.approx(0.5)
    if topic.name == "map":
        assert list(read.data) == [0, -1, 100, 0]
    if topic.name == "fix":
        assert read.position_covariance[0] == 4.0
        assert math.isnan(read.altitude)


VECTOR = {"x": 0.25, "y": 0.5, "z": 0.0}
QUATERNION = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
POSE = {"position": {"x": 1.5, "y": 2.0, "z": 0.0}, "orientation": QUATERNION}
TURN = {"translation": VECTOR, "rotation": QUATERNION}
STAMP = {"sec": 1, "nanosec": 2}
VALUES: dict[str, Any] = {
    "sensor/pose": {**POSE, "frame_id": "map"},
    "sensor/velocity": {"linear": VECTOR, "angular": VECTOR, "frame_id": "base_link"},
    "sensor/imu": {
        "orientation": QUATERNION,
        "angular_velocity": VECTOR,
        "linear_acceleration": VECTOR,
        "frame_id": "imu",
    },
    "sensor/orientation": {"orientation": QUATERNION, "angular_velocity": VECTOR},
    "sensor/battery": {"percentage": 0.5, "voltage": 12.0, "current": None, "charging": True},
    "sensor/scan": {
        "angle_min": 0.0,
        "angle_increment": 0.1,
        "range_min": 0.1,
        "range_max": 5.0,
        "ranges": [1.0, math.inf, 2.0],
        "frame_id": "laser",
    },
    "sensor/joint_states": {"name": ["a"], "position": [1.0], "velocity": [0.0], "effort": None},
    "sensor/gnss": {
        "fix": "3d",
        "latitude": 48.0,
        "longitude": 11.0,
        "altitude": None,
        "satellites": 9,
        "horizontal_accuracy": 2.0,
    },
    "sensor/camera": {"format": "png", "data": b"\x89PNG", "frame_id": "camera"},
    "sensor/map": {
        "resolution": 0.1,
        "width": 2,
        "height": 2,
        "origin": POSE,
        "data": b"\x00\xff\x64\x00",
        "frame_id": "map",
    },
    "sensor/points": {
        "header": {"frame_id": "camera"},
        "height": 1,
        "width": 1,
        "fields": [{"name": "x", "offset": 0, "datatype": 7, "count": 1}],
        "is_bigendian": False,
        "point_step": 4,
        "row_step": 4,
        "data": b"\0\0\0\0",
        "is_dense": True,
    },
    "sensor/transforms": {
        "transforms": [
            {
                "header": {"stamp": STAMP, "frame_id": "map"},
                "child_frame_id": "odom",
                "transform": TURN,
            }
        ]
    },
    "param/robot_description": "<robot/>",
}
