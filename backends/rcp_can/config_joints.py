"""The configuration of a joint group: several motors that move as one robot."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_can.config_names import Name

__all__ = ["JointGroupConfig"]


class JointGroupConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which motors are its joints, and how they move together."""

    joints: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=64)]
    """Names of motors, which are those of the joints."""
    acceleration: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s2"})] = 5.0
    """Of a joint in `move_joints` whose motor has none."""
    valid_for: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "s"})] = 0.5
    """Seconds that joint positions stand before the dead-man lets the joints stay where they are."""

    def __post_init__(self) -> None:
        if len(set(self.joints)) != len(self.joints):
            raise ValueError("`joints` lists a motor twice")
