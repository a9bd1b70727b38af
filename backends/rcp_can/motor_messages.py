"""The values of a motor, the same for every make; radians, N·m and amperes at the joint."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

__all__ = [
    "Health",
    "Mode",
    "Motion",
    "MotorFault",
    "MotorState",
    "Move",
    "MoveFeedback",
    "Moved",
    "State",
]

Radians = Annotated[float, Meta(extra_json_schema={"unit": "rad"})]
Speed = Annotated[float, Meta(extra_json_schema={"unit": "rad/s"})]
Torque = Annotated[float, Meta(extra_json_schema={"unit": "N.m"})]
Amperes = Annotated[float, Meta(extra_json_schema={"unit": "A"})]
Volts = Annotated[float, Meta(extra_json_schema={"unit": "V"})]
Celsius = Annotated[float, Meta(extra_json_schema={"unit": "Cel"})]
Seconds = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})]
Above = Annotated[float, Meta(gt=0, le=1e6, extra_json_schema={"unit": "rad/s"})]
Tolerance = Annotated[float, Meta(gt=0, le=10, extra_json_schema={"unit": "rad"})]
Code = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]

Mode = Literal["position", "velocity", "torque"]
State = Literal["offline", "no_feedback", "disabled", "enabled", "stopping", "quick_stop", "fault"]
"""`no_feedback`: messages arrive, but a signal that control requires is too old; `quick_stop`: it
was stopped, accepts no set-points and holds torque."""


class Motion(Struct, frozen=True, kw_only=True):
    """Measurements of the drive, at the joint."""

    position: Radians | None = None
    velocity: Speed | None = None
    torque: Torque | None = None
    current: Amperes | None = None


class Health(Struct, frozen=True, kw_only=True):
    """Temperatures and supply, as far as the drive reports them."""

    drive_temperature: Celsius | None = None
    motor_temperature: Celsius | None = None
    voltage: Volts | None = None


class MotorState(Struct, frozen=True, kw_only=True):
    """The state of a motor."""

    state: State
    mode: Mode | None = None
    """The commanded mode, if there is a command."""
    faults: list[str] = []
    reached: bool | None = None
    """Whether the drive reports its target reached; None if it does not report that."""
    homed: bool | None = None
    energised: bool | None = None
    """Whether it applies or holds torque; None: unknown."""
    watchdog: Seconds | None = None
    """Seconds without messages after which the drive stops by itself; None: it does not."""
    watchdog_verified: bool = False
    """Whether this time was read back from the drive."""


class MotorFault(Struct, frozen=True, kw_only=True):
    """A fault that appeared or cleared: of the drive, its link or its configuration."""

    fault: str
    text: str
    active: bool
    code: Code | None = None
    """The drive's own error number, if it has one."""


class Move(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Target and limits of a move."""

    position: Radians
    velocity: Above | None = None
    """Maximum velocity; the motor's limit by default."""
    tolerance: Tolerance | None = None
    """Position tolerance; the motor's own by default."""


class MoveFeedback(Struct, frozen=True, kw_only=True):
    """Progress of a move; `left` is the remaining distance."""

    position: Radians
    left: Radians


class Moved(Struct, frozen=True, kw_only=True):
    """The position at which a move ended, as reported by the drive."""

    position: Radians
    duration: Seconds
