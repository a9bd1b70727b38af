"""The limits of a joint in its group: the smallest of the group's and the motor's."""

from __future__ import annotations

import math
from typing import NamedTuple

from rcp_can.axis import Axis
from rcp_can.config_joints import JointConfig, JointGroupConfig
from rcp_kernel.errors import ConfigError

__all__ = ["JointLimits", "joint_limits"]


class JointLimits(NamedTuple):
    """rad, rad/s and rad/s² at the joint."""

    low: float
    high: float
    velocity: float
    acceleration: float


def joint_limits(group: str, config: JointGroupConfig, axis: Axis) -> JointLimits:
    """Return the limits of one joint.

    :raises ConfigError: the position ranges of group and motor do not overlap.
    """
    own = config.limits.get(axis.name) or JointConfig()
    low, high = own.position or (-math.inf, math.inf)
    low, high = max(low, axis.low), min(high, axis.high)
    if low >= high:
        raise ConfigError(
            f"joint_groups.{group}.limits.{axis.name}.position: no position is also within the "
            f"{axis.low:g} to {axis.high:g} rad of the motor"
        )
    acceleration = axis.config.acceleration or config.acceleration
    return JointLimits(
        low,
        high,
        min(own.velocity or math.inf, axis.velocity_limit),
        min(own.acceleration or math.inf, acceleration),
    )
