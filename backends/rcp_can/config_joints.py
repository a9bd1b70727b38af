"""The configuration of a joint group: several motors that move as one robot."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_can.config_names import Name

__all__ = ["JointConfig", "JointGroupConfig"]

Positive = Annotated[float, Meta(gt=0)]


class JointConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits of one joint in its group; those of its motor apply as well."""

    position: tuple[float, float] | None = None
    """Lowest and highest position, rad."""
    velocity: Positive | None = None
    """rad/s."""
    acceleration: Positive | None = None
    """rad/s²."""

    def __post_init__(self) -> None:
        if self.position is not None and self.position[0] >= self.position[1]:
            raise ValueError("`position` is [lowest, highest], with lowest < highest")


class JointGroupConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The motors of the joints, and the parameters of synchronized moves."""

    joints: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=64)]
    """Names of the motors, which are also the names of the joints."""
    acceleration: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s2"})] = 5.0
    """Acceleration in moves of a joint whose motor has none."""
    limits: dict[Name, JointConfig] = {}
    """Limits of joints in this group, by name."""
    tracking_tolerance: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad"})] = 0.1
    """Distance of a joint from its trajectory at which the trajectory is aborted."""
    valid_for: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "s"})] = 0.5
    """Validity of joint positions in s, before the dead-man stops the joints."""
    as_robot: bool = False
    """Offer `action/move_joints`, not `action/<name>/move_joints`: the backend's robot is this arm."""

    def __post_init__(self) -> None:
        if len(set(self.joints)) != len(self.joints):
            raise ValueError("`joints` lists a motor twice")
        for name in self.limits:
            if name not in self.joints:
                raise ValueError(f"`limits` contains {name!r}, which is not in `joints`")
