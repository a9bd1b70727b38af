"""The value types of a joint group: one field per joint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta

from rcp_can.axis import Axis
from rcp_kernel.types import quantity

__all__ = ["JointTypes", "joint_types"]

Part = Annotated[float, Meta(gt=0, le=1, extra_json_schema={"unit": "1"})]


class JointTypes(NamedTuple):
    """The types of one group."""

    targets: Any
    """Positions within the joints' limits; each may be left out."""
    states: Any
    move: Any
    feedback: Any
    moved: Any


def joint_types(axes: Sequence[Axis]) -> JointTypes:
    """Create the types for a group of joints."""

    def struct(name: str, fields: list[tuple[Any, ...]]) -> Any:
        return msgspec.defstruct(
            name, fields, frozen=True, forbid_unknown_fields=True, kw_only=True
        )

    def per_joint(name: str, types: Sequence[Any], *, optional: bool = False) -> Any:
        fields: list[tuple[Any, ...]] = []
        for number, (axis, type_) in enumerate(zip(axes, types, strict=True)):
            given = msgspec.field(name=axis.name, **({"default": None} if optional else {}))
            fields.append((f"joint_{number}", type_ | None if optional else type_, given))
        return struct(name, fields)

    limits = [quantity("rad", ge=axis.low, le=axis.high) for axis in axes]
    targets = per_joint("JointTargets", limits, optional=True)
    positions = per_joint("JointPositions", [quantity("rad")] * len(axes))
    velocities = per_joint("JointVelocities", [quantity("rad/s")] * len(axes))
    return JointTypes(
        targets,
        struct("JointStates", [("positions", positions), ("velocities", velocities)]),
        struct("MoveJoints", [("positions", targets), ("speed", Part, 1.0)]),
        struct("MoveJointsFeedback", [("positions", positions), ("left", quantity("rad"))]),
        struct("JointsMoved", [("positions", positions), ("duration", quantity("s", ge=0))]),
    )
