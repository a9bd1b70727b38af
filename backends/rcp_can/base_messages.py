"""The values of a differential drive: metres and radians, forward and to the left positive."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_kernel.types import (
    AngularVelocity,
    LinearVelocity,
    Metres,
    Point,
    PoseStamped,
    Radians,
    Time,
)

__all__ = ["DriveStopped", "MoveFeedback", "MoveResult", "MoveTo", "Reset", "TwistStamped"]

_Distance = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m"})]
_Duration = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})]
_Tolerance = Annotated[float, Meta(gt=0, le=10, extra_json_schema={"unit": "m"})]
_Speed = Annotated[float, Meta(gt=0, extra_json_schema={"unit": "m/s"})]


class TwistStamped(Struct, frozen=True, forbid_unknown_fields=True):
    """A measured velocity, in a named frame at a time."""

    linear: LinearVelocity = LinearVelocity()
    angular: AngularVelocity = AngularVelocity()
    frame_id: str = "base_link"
    timestamp: Time | None = None


class MoveTo(Struct, frozen=True, forbid_unknown_fields=True):
    """A place to go to; `position.z` is ignored."""

    position: Point
    frame: Annotated[str, Meta(description="Only `odom`.")] = "odom"
    yaw: (
        Annotated[Radians, Meta(description="Heading at the goal, counter-clockwise from x.")]
        | None
    ) = None
    tolerance: _Tolerance | None = None
    speed: _Speed | None = None


class MoveFeedback(Struct, frozen=True, forbid_unknown_fields=True):
    """How far it still is."""

    distance_remaining: _Distance
    eta: _Duration | None
    """None if the speed limit is zero."""


class MoveResult(Struct, frozen=True, forbid_unknown_fields=True):
    """Where it arrived, as measured at rest."""

    pose: PoseStamped
    error: Metres


class DriveStopped(Struct, frozen=True, kw_only=True):
    """A wheel lost its set-point, so the robot was stopped."""

    motor: str
    reason: str
    """Why, as a code: `adapter_unavailable`, `mode_forbids`, …"""
    text: str


class Reset(Struct, frozen=True, forbid_unknown_fields=True):
    """What to reset; without input, all of it."""

    odometry: bool = True
    faults: bool = True
    speed_limit: bool = True
