"""The resources of a joint group."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Self

from rcp_can.config_joints import JointGroupConfig
from rcp_can.joint_limits import JointLimits
from rcp_can.joint_types import JointTypes
from rcp_kernel.model import Resource
from rcp_profiles import claim, offer

__all__ = ["JointNames", "joint_resources"]

_MOVE = 120.0  # s, the longest that a move may take
_TRAJECTORY = 3600.0  # s
_SLOWLY = 4.0  # ratio of the example trajectory's duration to the shortest one


class JointNames(NamedTuple):
    """The names of its resources."""

    states: str
    joints: str
    targets: str
    move: str
    follow: str

    @classmethod
    def make(cls, place: str | None) -> Self:
        """Return the names, below a segment if one is given."""
        below = f"{place}/" if place else ""
        return cls(
            f"sensor/{below}joint_states",
            f"sensor/{below}joints",
            f"actuator/{below}joints",
            f"action/{below}move_joints",
            f"action/{below}follow_trajectory",
        )


def joint_resources(
    config: JointGroupConfig,
    limits: Mapping[str, JointLimits],
    types: JointTypes,
    timeout: float,
    place: str | None,
) -> list[Resource]:
    """List the resources of one joint group, which has the profile `arm`."""
    middle = {name: _near_rest(each) for name, each in limits.items()}
    positions = {f"positions.{name}": (each.low, each.high) for name, each in limits.items()}
    velocities = {
        f"velocities.{name}": (-each.velocity, each.velocity) for name, each in limits.items()
    }
    slowest = max(
        _SLOWLY * (1.0 / each.velocity + each.acceleration**-0.5) for each in limits.values()
    )
    meta = {"joints": [*limits]}
    return claim(
        ["arm"],
        offer("sensor/joint_states", live=True, deadline=timeout, meta=meta),
        offer(
            "action/move_joints",
            positions,
            examples=({"positions": middle}, {"positions": middle, "speed": 0.5}),
            timeout=_MOVE,
            meta=meta,
        ),
        offer(
            "action/follow_trajectory",
            {f"points.{place}": bound for place, bound in (positions | velocities).items()},
            examples=({"points": [{"time": round(slowest, 2), "positions": middle}]},),
            timeout=_TRAJECTORY,
            meta=meta,
        ),
        Resource(
            name="sensor/joints",
            description="Positions and velocities of all joints, by name.",
            value=types.states,
            live=True,
            deadline=timeout,
            meta=meta,
        ),
        Resource(
            name="actuator/joints",
            description="Target positions; a joint that is not listed keeps its position.",
            value=types.targets,
            examples=(middle, {}),
            max_age=1.0,
            valid_for=config.valid_for,
            safe={},
            meta=meta,
        ),
        place=place,
    )


def _near_rest(limits: JointLimits) -> float:
    low, high = max(limits.low, -1.0), min(limits.high, 1.0)
    return round(low + 0.55 * (high - low), 4)
