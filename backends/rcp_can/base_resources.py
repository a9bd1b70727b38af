"""The resources of a differential drive."""

from __future__ import annotations

from typing import NamedTuple, Self

from rcp_can.axle import Axle
from rcp_can.base_messages import DriveStopped
from rcp_can.config_diff_drive import DiffDriveConfig
from rcp_kernel.model import Resource
from rcp_profiles import claim, offer

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
    def make(cls, place: str | None) -> Self:
        """Return the names of the profile, below a segment if one is given."""
        below = f"{place}/" if place else ""
        return cls(
            f"actuator/{below}cmd_vel",
            f"sensor/{below}velocity",
            f"sensor/{below}pose",
            f"param/{below}speed_limit",
            f"action/{below}move_to",
            f"event/{below}stopped",
        )


def base_resources(config: DiffDriveConfig, axle: Axle, place: str | None) -> list[Resource]:
    """List the resources of one differential drive, which has the profile `mobile`."""
    timeout = max(wheel.config.timeout for wheel in axle.wheels)
    speed, turn = round(axle.top_speed, 9), round(axle.top_turn, 9)
    still = (0.0, 0.0)
    limits = {"linear.x": (-speed, speed), "linear.y": still, "linear.z": still}
    limits |= {"angular.x": still, "angular.y": still, "angular.z": (-turn, turn)}
    return claim(
        ["mobile"],
        offer(
            "actuator/cmd_vel",
            limits,
            examples=({"linear": {"x": speed / 10}}, {"angular": {"z": turn / 10}}),
            valid_for=config.valid_for,
        ),
        offer("sensor/velocity", live=True, deadline=timeout),
        offer("sensor/pose", live=True, deadline=timeout),
        offer("param/speed_limit", (0.0, speed), examples=(speed / 2, speed)),
        offer(
            "action/move_to",
            examples=(
                {"position": {"x": 0.2, "y": 0.0}, "frame": "odom"},
                {"position": {"x": 0.2, "y": 0.1}, "frame": "odom", "yaw": 1.57},
            ),
            timeout=_MOVE,
        ),
        Resource(
            name="event/stopped",
            description="A wheel lost its set-point, so both were stopped.",
            value=DriveStopped,
            live=True,
        ),
        place=place,
    )
