"""The configuration of a joint group: several motors that move as one robot."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_can.config_names import Name

__all__ = ["JointGroupConfig"]


class JointGroupConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The motors of the joints, and the parameters of synchronized moves."""

    joints: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=64)]
    """Names of the motors, which are also the names of the joints."""
    acceleration: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s2"})] = 5.0
    """Acceleration in `move_joints` of a joint whose motor has none."""
    valid_for: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "s"})] = 0.5
    """Validity of joint positions in s, before the dead-man stops the joints."""

    as_robot: bool = False
    """Offer `action/move_joints`, not `action/<name>/move_joints`: the backend's robot is this arm."""

    def __post_init__(self) -> None:
        if len(set(self.joints)) != len(self.joints):
            raise ValueError("`joints` lists a motor twice")
