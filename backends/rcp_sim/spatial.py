"""Types of frames, joints and clouds, with the names that ROS has for their fields; metres, radians, seconds."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_kernel.types import Point, Quaternion

__all__ = [
    "FLOAT32",
    "Header",
    "JointState",
    "PointCloud",
    "PointField",
    "Rigid",
    "Stamp",
    "TransformStamped",
    "Transforms",
    "stamped",
]

FLOAT32 = 7
_BILLION = 1_000_000_000
_Seconds = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "s"})]
_Nanoseconds = Annotated[int, Meta(ge=0, lt=_BILLION, extra_json_schema={"unit": "ns"})]
_Count = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]
_Kind = Annotated[
    int,
    Meta(ge=1, le=8, description="7: a float of 4 bytes.", extra_json_schema={"unit": "1"}),
]
_Bytes = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "By"})]
_Angle = Annotated[float, Meta(extra_json_schema={"unit": "rad"})]
_Turning = Annotated[float, Meta(extra_json_schema={"unit": "rad/s"})]


class Stamp(Struct, frozen=True, forbid_unknown_fields=True):
    """A time since the epoch."""

    sec: _Seconds = 0
    nanosec: _Nanoseconds = 0


class Header(Struct, frozen=True, forbid_unknown_fields=True):
    """When, and in which frame."""

    stamp: Stamp = Stamp()
    frame_id: str = ""


def stamped(frame: str, now: int) -> Header:
    """Return the header of a value of this time, ns since the epoch."""
    return Header(Stamp(*divmod(now, _BILLION)), frame)


class Rigid(Struct, frozen=True, forbid_unknown_fields=True):
    """Where one frame is in another."""

    translation: Point
    rotation: Quaternion = Quaternion()


class TransformStamped(Struct, frozen=True, forbid_unknown_fields=True):
    """Where a frame is in the one of the header."""

    header: Header
    child_frame_id: str
    transform: Rigid


class Transforms(Struct, frozen=True, forbid_unknown_fields=True):
    """The tree of frames, as tf2_msgs/TFMessage has it."""

    transforms: list[TransformStamped]


class JointState(Struct, frozen=True, forbid_unknown_fields=True):
    """The joints of the robot's description, as sensor_msgs/JointState has them."""

    header: Header
    name: list[str]
    position: list[_Angle]
    velocity: list[_Turning]


class PointField(Struct, frozen=True, forbid_unknown_fields=True):
    """Where a part of a point lies in its bytes."""

    name: str
    offset: _Bytes
    datatype: _Kind = FLOAT32
    count: _Count = 1


class PointCloud(Struct, frozen=True, forbid_unknown_fields=True):
    """Points as bytes, as sensor_msgs/PointCloud2 has them."""

    header: Header
    height: _Count
    width: _Count
    fields: list[PointField]
    is_bigendian: bool
    point_step: _Bytes
    row_step: _Bytes
    data: bytes
    is_dense: bool = True
