"""The next set-point of a motor: on the ramp, within its limits, at the drive's shaft."""

from __future__ import annotations

from typing import NamedTuple

from rcp_can.axis_state import AxisState
from rcp_can.codec import clamp
from rcp_can.motor_messages import Mode

__all__ = ["SetPoint", "set_point", "torque_offset"]


class SetPoint(NamedTuple):
    """A set-point; in mode position, `velocity` is that of the ramp."""

    mode: Mode
    value: float
    velocity: float = 0.0


def torque_offset(axis: AxisState) -> float | None:
    """Return the torque against gravity at the drive's shaft; None if it is not to be fed forward."""
    if axis.gravity is None:
        return None
    position = axis.ramp.position if axis.mode == "position" else axis.position
    if axis.mode == "torque" or position is None:
        return 0.0
    return axis.gravity.torque(position) / axis.ratio


def set_point(axis: AxisState, dt: float) -> SetPoint | None:
    """Advance the ramp by `dt` s and return the next set-point; None if there is no command."""
    match axis.mode:
        case "velocity":
            path = axis.ramp.path
            goal = _within(axis, axis.goal if path is None else path()[1])
            return SetPoint("velocity", axis.ramp.to_velocity(goal, dt) * axis.ratio)
        case "position":
            goal = clamp(axis.goal, axis.low, axis.high)
            value = (axis.ramp.to_position(goal, dt) - axis.config.offset) * axis.ratio
            return SetPoint("position", value, axis.ramp.velocity * axis.ratio)
        case "torque":
            torque = clamp(axis.goal, -axis.torque_limit, axis.torque_limit)
            return SetPoint("torque", torque / axis.ratio)
        case _:
            return None


def _within(axis: AxisState, velocity: float) -> float:
    """Limit a velocity so that the joint cannot leave its allowed positions."""
    if axis.config.position is None:
        return velocity
    position = axis.position
    if position is None or not axis.is_fresh("position"):
        return 0.0  # a limit cannot rely on an old position
    out = (position >= axis.high and velocity > 0) or (position <= axis.low and velocity < 0)
    return 0.0 if out else velocity
