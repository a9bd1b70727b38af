"""Messages as values of the profiles: the profile's fields, then what else the message has."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec

from rcp_kernel.types import LaserScan, Point, PoseStamped, Quaternion
from rcp_profiles import messages as m
from rcp_protocol.clock import iso
from rcp_protocol.types import AngularVelocity, LinearVelocity
from rcp_ros2.cdr import Codec, Malformed

__all__ = ["SHAPES", "Shape", "Shaped", "extended", "joints_of", "seconds", "stamped_pose"]


class Shape(NamedTuple):
    """How a message becomes the value of a profile's resource."""

    type: type[msgspec.Struct]
    fields: Callable[[Any], dict[str, Any]]
    """Returns the profile's fields of a decoded message."""
    whole: bool = False
    """Whether the message's other fields are kept: the path was the message's before."""
    joints: frozenset[str] = frozenset()
    """Those of the value, if not all of the message: it may have none of them."""


class Shaped(Codec):
    """Decodes a message as the value of a profile's resource."""

    def __init__(self, cls: Any, shape: Shape) -> None:
        super().__init__(cls)
        self._fields = shape.fields
        native = self.type
        self.type = extended(shape.type, native) if shape.whole else shape.type
        known = {field.name for field in msgspec.structs.fields(shape.type)}
        names = (field.name for field in msgspec.structs.fields(native))
        self._joints = shape.joints
        self._named = Codec(cls, "name") if shape.joints else None
        self._more = tuple(name for name in names if name not in known) if shape.whole else ()

    def concerns(self, data: bytes) -> bool:
        """Return whether a message has one of the joints, if those are only some of a topic's."""
        if self._named is None:
            return True
        try:
            return not self._joints.isdisjoint(self._named.decode(data))
        except Malformed:
            return True  # decoding it says why

    def decode(self, data: bytes) -> Any:
        """Return the value.

        :raises Malformed: the bytes are no such message, or it has a NaN where a robot has a number.
        """
        message = super().decode(data)
        more = {name: getattr(message, name) for name in self._more}
        return self.type(**self._fields(message), **more)


@lru_cache(maxsize=256)
def extended(profile: type[msgspec.Struct], native: type[msgspec.Struct]) -> Any:
    """Return a type with the fields of a profile's type, and those that only a message has."""
    known = {field.name for field in msgspec.structs.fields(profile)}
    more = [
        (field.name, field.type)
        for field in msgspec.structs.fields(native)
        if field.name not in known
    ]
    return msgspec.defstruct(
        profile.__name__,
        more,
        bases=(profile,),
        namespace={"__doc__": profile.__doc__},
        module=native.__module__,
        frozen=True,
        forbid_unknown_fields=True,
        kw_only=True,
    )


def seconds(time: Any) -> float:
    """Return a ROS time or duration in seconds."""
    return time.sec + time.nanosec / 1e9


def _header(message: Any, default: str) -> dict[str, Any]:
    stamp = message.header.stamp
    at = iso(stamp.sec * 1_000_000_000 + stamp.nanosec) if stamp.sec > 0 else None
    return {"frame_id": message.header.frame_id or default, "timestamp": at}


def _finite(*numbers: float) -> tuple[float, ...]:
    if not all(map(math.isfinite, numbers)):
        raise Malformed("the message has a NaN or an infinite number")
    return numbers


def _pose_of(pose: Any, header: dict[str, Any]) -> PoseStamped:
    p, q = pose.position, pose.orientation
    return PoseStamped(
        Point(*_finite(p.x, p.y, p.z)), Quaternion(*_finite(q.x, q.y, q.z, q.w)), **header
    )


def stamped_pose(stamped: Any) -> PoseStamped:
    """Return a geometry_msgs/msg/PoseStamped."""
    return _pose_of(stamped.pose, _header(stamped, "map"))


def _pose(message: Any) -> dict[str, Any]:
    return msgspec.structs.asdict(_pose_of(message.pose.pose, _header(message, "odom")))


def _velocity(message: Any) -> dict[str, Any]:
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    return {
        **_header(message, ""),
        "frame_id": message.child_frame_id or "base_link",
        "linear": LinearVelocity(*_finite(linear.x, linear.y, linear.z)),
        "angular": AngularVelocity(*_finite(angular.x, angular.y, angular.z)),
    }


def _scan(message: Any) -> dict[str, Any]:
    names = ("angle_min", "angle_increment", "range_min", "range_max", "ranges")
    return {name: getattr(message, name) for name in names} | _header(message, "laser")


def _battery(message: Any) -> dict[str, Any]:
    def known(number: float) -> float | None:
        return number if math.isfinite(number) else None

    share, voltage = known(message.percentage), known(message.voltage)
    status = message.power_supply_status  # 0 unknown, 1 charging, 2 discharging, 3 idle, 4 full
    return {
        "percentage": None if share is None else min(1.0, max(0.0, share)),
        "voltage": None if voltage is None else max(0.0, voltage),
        "current": known(message.current),
        "charging": None if status == 0 else status == 1,
        "timestamp": _header(message, "")["timestamp"],
    }


def _joints(message: Any) -> dict[str, Any]:
    def each(numbers: Any) -> list[float]:
        return list(_finite(*numbers))

    effort = [] if any(map(math.isnan, message.effort)) else list(message.effort)
    velocity = [] if any(map(math.isnan, message.velocity)) else each(message.velocity)
    return {
        "name": list(message.name),
        "position": each(message.position),
        "velocity": velocity,
        "effort": effort or None,
        "timestamp": _header(message, "")["timestamp"],
    }


def joints_of(names: tuple[str, ...]) -> Shape:
    """Return the shape of joint states with these joints only."""

    def part(message: Any) -> dict[str, Any]:
        own = [at for at, name in enumerate(message.name) if name in names]
        whole = _joints(message)
        lists: dict[str, Any] = {
            key: [whole[key][at] for at in own if at < len(whole[key])]
            for key in ("name", "position", "velocity")
        }
        effort = whole["effort"]
        lists["effort"] = None if effort is None else [effort[at] for at in own if at < len(effort)]
        return whole | lists

    return Shape(m.JointStates, part, joints=frozenset(names))


def _image(message: Any) -> dict[str, Any]:
    data = bytes(message.data)
    format_, (width, height) = _measured(data)
    return {
        **_header(message, "camera"),
        "width": width,
        "height": height,
        "data": data,
        "format": format_,
    }


def _measured(data: bytes) -> tuple[str, tuple[int, int]]:
    """Return the format of an image file, its width and height."""
    if data.startswith(b"\x89PNG\r\n\x1a\n") and len(data) >= 24:
        return "png", (int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big"))
    at = 2
    while data.startswith(b"\xff\xd8\xff") and at + 9 < len(data):
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):  # a start of frame
            height = int.from_bytes(data[at + 5 : at + 7], "big")
            return "jpeg", (int.from_bytes(data[at + 7 : at + 9], "big"), height)
        at += 2 + length
    raise Malformed("the image is neither a JPEG nor a PNG")


SHAPES = {
    "sensor/pose": Shape(PoseStamped, _pose),
    "sensor/velocity": Shape(m.TwistStamped, _velocity),
    "sensor/scan": Shape(LaserScan, _scan, whole=True),
    "sensor/battery": Shape(m.BatteryState, _battery, whole=True),
    "sensor/joint_states": Shape(m.JointStates, _joints),
    "sensor/camera": Shape(m.Image, _image),
}
"""By the name of the resource."""
