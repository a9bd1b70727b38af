"""Common value types: quantities, geometry, time. Metres, radians, seconds.

Frames follow REP-103 (x forward, y left, z up; right-handed), quaternions are x, y, z, w. Values
are msgspec Structs; a `ValueType` (see `values.py`) derives validator, encoders and schema from
them, so that each type has a single definition.
"""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
from msgspec import Meta

__all__ = [
    "NONFINITE",
    "Accel",
    "AngularAcceleration",
    "AngularVelocity",
    "Int64",
    "LaserScan",
    "LinearAcceleration",
    "LinearVelocity",
    "Metres",
    "Point",
    "Pose",
    "PoseStamped",
    "Quaternion",
    "Radians",
    "Ratio",
    "Real",
    "Seconds",
    "Time",
    "Transform",
    "Twist",
    "UInt64",
    "Vector3",
    "nonfinite",
    "quantity",
]

NONFINITE = "x-rcp-nonfinite"
"""Schema marker of a float that may be NaN or infinite; the published schema lists the
spellings."""


def quantity(
    unit: str,
    base: Any = float,
    *,
    ge: float | None = None,
    gt: float | None = None,
    le: float | None = None,
    lt: float | None = None,
    description: str | None = None,
    may_be_nonfinite: bool = False,
) -> Any:
    """Return the type of a number with a unit (UCUM: `m/s`, `rad`, `Cel`, `1`) and bounds.

    `may_be_nonfinite` allows NaN and ±Infinity, for a reading that may be missing.
    """
    extra: Any = {"unit": unit}
    if may_be_nonfinite:
        extra[NONFINITE] = True
    bounds: Any = {"ge": ge, "gt": gt, "le": le, "lt": lt, "description": description}
    return Annotated[base, Meta(**bounds, extra_json_schema=extra)]


def nonfinite(unit: str) -> Any:
    """Return the type of a reading that may be NaN or infinite: no return, not measured."""
    return quantity(unit, may_be_nonfinite=True)


Metres = Annotated[float, Meta(extra_json_schema={"unit": "m"})]
Radians = Annotated[float, Meta(extra_json_schema={"unit": "rad"})]
Seconds = Annotated[float, Meta(extra_json_schema={"unit": "s"})]
Ratio = Annotated[float, Meta(ge=0, le=1, extra_json_schema={"unit": "1"})]
Real = Annotated[float, Meta(extra_json_schema={NONFINITE: True})]
"""A float of unknown unit that may be NaN or infinite, as in robots' own types."""
Int64 = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
UInt64 = Annotated[int, Meta(ge=0, extra_json_schema={"maximum": 2**64 - 1})]
"""Its upper bound is checked by `values.py`: msgspec's own bounds end at int64."""
Time = Annotated[
    str,
    Meta(
        description="ISO 8601 in UTC, nanoseconds allowed.",
        pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{1,9})?Z$",
        examples=["2026-05-29T14:12:04Z"],
    ),
]

_MPS = Annotated[float, Meta(extra_json_schema={"unit": "m/s"})]
_RADPS = Annotated[float, Meta(extra_json_schema={"unit": "rad/s"})]
_MPS2 = Annotated[float, Meta(extra_json_schema={"unit": "m/s2"})]
_RADPS2 = Annotated[float, Meta(extra_json_schema={"unit": "rad/s2"})]
_UNIT = Annotated[float, Meta(ge=-1.000001, le=1.000001, extra_json_schema={"unit": "1"})]


class Vector3(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A vector; the field that contains it defines its unit."""

    x: Annotated[float, Meta(extra_json_schema={"unit": "1"})] = 0.0
    y: Annotated[float, Meta(extra_json_schema={"unit": "1"})] = 0.0
    z: Annotated[float, Meta(extra_json_schema={"unit": "1"})] = 0.0


class Point(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A position in metres."""

    x: Metres
    y: Metres
    z: Metres = 0.0


class Quaternion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An orientation as a unit quaternion."""

    x: _UNIT = 0.0
    y: _UNIT = 0.0
    z: _UNIT = 0.0
    w: _UNIT = 1.0


class Pose(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Position and orientation."""

    position: Point
    orientation: Quaternion = Quaternion()


class PoseStamped(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A pose in a named frame at a time."""

    position: Point
    orientation: Quaternion = Quaternion()
    frame_id: str = "map"
    timestamp: Time | None = None


class LinearVelocity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A linear velocity."""

    x: _MPS = 0.0
    y: _MPS = 0.0
    z: _MPS = 0.0


class AngularVelocity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An angular velocity about the axes."""

    x: _RADPS = 0.0
    y: _RADPS = 0.0
    z: _RADPS = 0.0


class Twist(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Linear and angular velocity in the body frame."""

    linear: LinearVelocity = LinearVelocity()
    angular: AngularVelocity = AngularVelocity()


class LinearAcceleration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A linear acceleration."""

    x: _MPS2 = 0.0
    y: _MPS2 = 0.0
    z: _MPS2 = 0.0


class AngularAcceleration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An angular acceleration about the axes."""

    x: _RADPS2 = 0.0
    y: _RADPS2 = 0.0
    z: _RADPS2 = 0.0


class Accel(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Linear and angular acceleration in the body frame."""

    linear: LinearAcceleration = LinearAcceleration()
    angular: AngularAcceleration = AngularAcceleration()


class Transform(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The pose of `child_frame_id` in `frame_id`."""

    translation: Point
    rotation: Quaternion
    frame_id: str
    child_frame_id: str
    timestamp: Time | None = None


class LaserScan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One sweep of a planar range finder; a beam without a return is `Infinity`."""

    angle_min: Radians
    angle_increment: Radians
    range_min: Metres
    range_max: Metres
    ranges: list[nonfinite("m")]  # pyright: ignore[reportInvalidTypeForm]
    frame_id: str = "laser"
    timestamp: Time | None = None
