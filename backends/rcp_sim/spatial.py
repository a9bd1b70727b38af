"""Types of frames, joints and clouds, with the field names of ROS; metres, radians, seconds."""

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
    """Time and frame of a value."""

    stamp: Stamp = Stamp()
    frame_id: str = ""


def stamped(frame: str, now: int) -> Header:
    """Return the header for a time, ns since the epoch."""
    return Header(Stamp(*divmod(now, _BILLION)), frame)


class Rigid(Struct, frozen=True, forbid_unknown_fields=True):
    """Position and orientation of one frame relative to another."""

    translation: Point
    rotation: Quaternion = Quaternion()


class TransformStamped(Struct, frozen=True, forbid_unknown_fields=True):
    """The transform of a frame relative to the frame of the header."""

    header: Header
    child_frame_id: str
    transform: Rigid


class Transforms(Struct, frozen=True, forbid_unknown_fields=True):
    """The frame tree, as in tf2_msgs/TFMessage."""

    transforms: list[TransformStamped]


class JointState(Struct, frozen=True, forbid_unknown_fields=True):
    """Joints of the robot description, as in sensor_msgs/JointState."""

    header: Header
    name: list[str]
    position: list[_Angle]
    velocity: list[_Turning]


class PointField(Struct, frozen=True, forbid_unknown_fields=True):
    """Location of one field in a point's bytes."""

    name: str
    offset: _Bytes
    datatype: _Kind = FLOAT32
    count: _Count = 1


class PointCloud(Struct, frozen=True, forbid_unknown_fields=True):
    """Points as bytes, as in sensor_msgs/PointCloud2."""

    header: Header
    height: _Count
    width: _Count
    fields: list[PointField]
    is_bigendian: bool
    point_step: _Bytes
    row_step: _Bytes
    data: bytes
    is_dense: bool = True
