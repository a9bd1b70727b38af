"""The values of a motor: one model for every make. Radians, N·m and amperes at the joint."""

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
"""`no_feedback`: it is heard, but a signal that control needs is too old; `quick_stop`: it was
stopped, takes no set-points and holds torque."""


class Motion(Struct, frozen=True, kw_only=True):
    """What the drive measures, at the joint."""

    position: Radians | None = None
    velocity: Speed | None = None
    torque: Torque | None = None
    current: Amperes | None = None


class Health(Struct, frozen=True, kw_only=True):
    """Temperatures and supply, as far as the drive tells them."""

    drive_temperature: Celsius | None = None
    motor_temperature: Celsius | None = None
    voltage: Volts | None = None


class MotorState(Struct, frozen=True, kw_only=True):
    """How the motor stands."""

    state: State
    mode: Mode | None = None
    """What it is commanded to keep, if it is."""
    faults: list[str] = []
    reached: bool | None = None
    """Whether the drive reports its target reached; None where it has no word for that."""
    homed: bool | None = None
    energised: bool | None = None
    """Whether it gives or holds torque; None: unknown."""
    watchdog: Seconds | None = None
    """Silence of the gateway after which the drive stops by itself; None: nothing makes it."""
    watchdog_verified: bool = False
    """Whether that was read back from the drive."""


class MotorFault(Struct, frozen=True, kw_only=True):
    """A fault that came or went: of the drive, of its link, of its configuration."""

    fault: str
    text: str
    active: bool
    code: Code | None = None
    """The drive's own number, where it has one."""


class Move(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where to, and how."""

    position: Radians
    velocity: Above | None = None
    """At most; the motor's limit without it."""
    tolerance: Tolerance | None = None
    """How near counts as there; the motor's own without it."""


class MoveFeedback(Struct, frozen=True, kw_only=True):
    """How far a move is."""

    position: Radians
    left: Radians


class Moved(Struct, frozen=True, kw_only=True):
    """Where a move ended, by the drive's own word."""

    position: Radians
    duration: Seconds
