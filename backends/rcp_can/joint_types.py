"""The value types of a joint group: one field per joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from rcp_can.joint_limits import JointLimits
from rcp_kernel.types import quantity

__all__ = ["JointTypes", "joint_types"]


class JointTypes(NamedTuple):
    """The types of one group."""

    targets: Any
    """Positions within the joints' limits; each may be left out."""
    positions: Any
    velocities: Any
    states: Any
    """Positions and velocities."""


def joint_types(limits: Mapping[str, JointLimits]) -> JointTypes:
    """Create the types for a group of joints."""

    def struct(name: str, fields: list[tuple[Any, ...]]) -> Any:
        return msgspec.defstruct(
            name, fields, frozen=True, forbid_unknown_fields=True, kw_only=True
        )

    def per_joint(name: str, types: Sequence[Any], *, optional: bool = False) -> Any:
        fields: list[tuple[Any, ...]] = []
        for number, (joint, type_) in enumerate(zip(limits, types, strict=True)):
            given = msgspec.field(name=joint, **({"default": None} if optional else {}))
            fields.append((f"joint_{number}", type_ | None if optional else type_, given))
        return struct(name, fields)

    ranges = [quantity("rad", ge=each.low, le=each.high) for each in limits.values()]
    positions = per_joint("JointPositions", [quantity("rad")] * len(limits))
    velocities = per_joint("JointVelocities", [quantity("rad/s")] * len(limits))
    states = struct("JointStates", [("positions", positions), ("velocities", velocities)])
    return JointTypes(
        per_joint("JointTargets", ranges, optional=True), positions, velocities, states
    )
