"""Types generated from a model: one field for each joint, actuator or sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_kernel.types import quantity
from rcp_mujoco.joints import Drive
from rcp_mujoco.sensors import Reading

__all__ = ["drive_type", "given", "step_types"]

_Seconds = quantity("s", ge=0)
_Steps = Annotated[int, Meta(ge=1, le=100_000, extra_json_schema={"unit": "1"})]


def drive_type(drive: Drive) -> Any:
    """Make the type of an actuator's control."""
    return quantity(drive.unit, ge=drive.low, le=drive.high)


def step_types(drives: Sequence[Drive], readings: Sequence[Reading]) -> tuple[Any, Any]:
    """Make the input and the output of `service/step`."""
    controls = _struct(
        "Controls",
        [
            (
                f"control_{drive.number}",
                drive_type(drive) | None,
                msgspec.field(name=drive.name, default=None),
            )
            for drive in drives
        ],
    )
    step = _struct("Step", [("steps", _Steps, 1), ("controls", controls, controls())])
    fields = [
        (f"sensor_{number}", reading.value, msgspec.field(name=reading.name))
        for number, reading in enumerate(readings)
    ]
    sensors = _struct("Measurements", fields)
    return step, _struct("Observation", [("time", _Seconds), ("sensors", sensors)])


def given(controls: Any) -> dict[str, float]:
    """Return the controls that were given, by the name of the actuator."""
    fields = msgspec.structs.fields(controls)
    values = {field.encode_name: getattr(controls, field.name) for field in fields}
    return {name: value for name, value in values.items() if value is not None}


def _struct(name: str, fields: Sequence[Any]) -> Any:
    return msgspec.defstruct(name, fields, frozen=True, forbid_unknown_fields=True, kw_only=True)
