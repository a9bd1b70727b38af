"""What a differential drive declares."""

from __future__ import annotations

from typing import NamedTuple, Self

from rcp_can import base_messages as m
from rcp_can.config_diff_drive import DiffDriveConfig
from rcp_kernel.model import Resource
from rcp_kernel.types import PoseStamped, Twist, quantity

__all__ = ["BaseNames", "base_resources"]

_MOVE = 600.0  # s


class BaseNames(NamedTuple):
    """The names of its resources."""

    cmd_vel: str
    velocity: str
    pose: str
    speed_limit: str
    move_to: str
    stopped: str

    @classmethod
    def make(cls, prefix: str) -> Self:
        """Place the names below a prefix, which is empty or ends in a slash."""
        return cls(
            f"actuator/{prefix}cmd_vel",
            f"sensor/{prefix}velocity",
            f"sensor/{prefix}pose",
            f"param/{prefix}speed_limit",
            f"action/{prefix}move_to",
            f"event/{prefix}stopped",
        )


def base_resources(
    names: BaseNames, title: str, config: DiffDriveConfig, top_speed: float, timeout: float
) -> list[Resource]:
    """List the resources of one differential drive."""
    return [
        Resource(
            name=names.cmd_vel,
            description="Drive: linear.x in m/s and angular.z in rad/s; the rest must be zero.",
            value=Twist,
            examples=({"linear": {"x": 0.1}}, {"angular": {"z": 0.1}}),
            max_age=1.0,
            valid_for=config.valid_for,
            safe={},
        ),
        Resource(
            name=names.velocity,
            description=f"{title}: measured velocity, from its wheels.",
            value=m.TwistStamped,
            live=True,
            deadline=timeout,
        ),
        Resource(
            name=names.pose,
            description=f"{title}: place and heading since the start, from its wheels; they drift.",
            value=PoseStamped,
            live=True,
            deadline=timeout,
        ),
        Resource(
            name=names.speed_limit,
            description=f"{title}: maximum speed, for every command.",
            value=quantity("m/s", ge=0, le=round(top_speed, 9)),
            examples=(round(top_speed / 2, 4), round(top_speed, 9)),
        ),
        Resource(
            name=names.move_to,
            description=f"{title}: drive to a place in the frame odom; completes at rest there. It avoids nothing.",
            input=m.MoveTo,
            output=m.MoveResult,
            feedback=m.MoveFeedback,
            examples=(
                {"position": {"x": 0.2, "y": 0.0}},
                {"position": {"x": 0.2, "y": 0.1}, "yaw": 1.57, "speed": 0.2},
            ),
            timeout=_MOVE,
            max_age=30.0,
        ),
        Resource(
            name=names.stopped,
            description=f"{title}: a wheel lost its set-point, so both were stopped.",
            value=m.DriveStopped,
            live=True,
        ),
    ]
