"""From waypoints to curves, refused before anything moves if a joint could not follow them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rcp_can.cubic import Cubic, Knot, Sample
from rcp_can.joint_limits import JointLimits
from rcp_kernel.errors import InvalidValue, OutOfRange, RcpError

__all__ = ["Joint", "Point", "plan"]

_ROUNDING = 1 + 1e-6


class Point(NamedTuple):
    """A waypoint: positions and velocities by joint."""

    time: float
    positions: Mapping[str, float]
    velocities: Mapping[str, float]


class Joint(NamedTuple):
    """Where a joint is at rest now, and its limits."""

    start: float
    limits: JointLimits


def plan(points: Sequence[Point], joints: Mapping[str, Joint], near: float) -> dict[str, Cubic]:
    """Return a curve for each joint of the waypoints, from where it is.

    A first waypoint at time zero must be within `near` (rad) of where the joints are.

    :raises InvalidValue: the waypoints are incomplete, out of order, or do not end at rest.
    :raises OutOfRange: a joint would exceed its position, velocity or acceleration.
    """
    _check_order(points)
    if points[0].time == 0.0:
        _check_start(points[0], joints, near)
    curves: dict[str, Cubic] = {}
    for name in points[0].positions:
        knots = [Knot(0.0, joints[name].start, 0.0)]
        numbers = [number for number, point in enumerate(points) if point.time > 0.0]
        knots += [
            Knot(points[n].time, points[n].positions[name], points[n].velocities.get(name))
            for n in numbers
        ]
        knots[-1] = knots[-1]._replace(velocity=0.0)
        curves[name] = curve = Cubic(knots)
        for segment, number in enumerate(numbers):
            for sample in curve.extremes(segment):
                _check_limits(name, number, sample, joints[name].limits)
    return curves


def _check_order(points: Sequence[Point]) -> None:
    names = points[0].positions.keys()
    if not names:
        raise _invalid(0, "it names no joint", "/positions")
    last = -1.0
    for number, point in enumerate(points):
        if point.positions.keys() != names:
            raise _invalid(number, "it does not name the same joints as the first", "/positions")
        if unknown := point.velocities.keys() - names:
            raise _invalid(
                number, f"it has a velocity, but no position, of {min(unknown)}", "/velocities"
            )
        if point.time <= last:
            raise _invalid(number, "its time is not later than the one before", "/time")
        last = point.time
    if points[-1].time == 0.0:
        raise _invalid(0, "a trajectory takes longer than 0 s", "/time")
    if any(points[-1].velocities.values()):
        raise _invalid(len(points) - 1, "the last one is not at rest", "/velocities")


def _check_start(point: Point, joints: Mapping[str, Joint], near: float) -> None:
    for name, position in point.positions.items():
        off = abs(position - joints[name].start)
        if off > near:
            raise _invalid(
                0,
                f"joint '{name}' is {off:.3g} rad away from where it begins",
                f"/positions/{name}",
            )


def _invalid(number: int, text: str, field: str) -> RcpError:
    return InvalidValue(f"point {number}: {text}", details={"pointer": f"/points/{number}{field}"})


def _check_limits(name: str, number: int, sample: Sample, limits: JointLimits) -> None:
    for what, value, low, high, unit in (
        ("position", sample.position, limits.low, limits.high, "rad"),
        ("velocity", sample.velocity, -limits.velocity, limits.velocity, "rad/s"),
        ("acceleration", sample.acceleration, -limits.acceleration, limits.acceleration, "rad/s²"),
    ):
        slack = (_ROUNDING - 1) * max(abs(low), abs(high))
        if not low - slack <= value <= high + slack:
            raise OutOfRange(
                f"point {number}: {what} of joint '{name}' exceeds allowed range: {value:.4g} {unit} "
                f"on the way there is not within {low:.4g} and {high:.4g} {unit}",
                remedy="Allow more time between the points, or give more of them.",
                details={"pointer": f"/points/{number}", "joint": name},
            )
