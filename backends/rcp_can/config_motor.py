"""The configuration of one motor: which drive it is, what it turns, and how far it may go."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from rcp_can.config_names import BusName, Seconds

__all__ = ["BUILTIN_PROFILES", "MotorConfig"]

BUILTIN_PROFILES = "cia402", "odrive", "mit", "tmotor", "damiao", "moteus", "vesc", "cybergear"
"""Profiles that come with the backend."""
_PERIODS_PER_WATCHDOG = 3  # set-points in the time of a watchdog, for some may get lost
Positive = Annotated[float, Meta(gt=0, le=1e6)]


class MotorConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One motor. Limits are those of the joint, behind the gear."""

    bus: BusName
    profile: Annotated[str, Meta(max_length=200)]
    """One of the house's, or `module:NAME` of one of your own."""
    node: Annotated[int, Meta(ge=0, le=0x7FF)]
    gear: Positive = 1.0
    """Turns of the drive's shaft for one of the joint."""
    direction: Literal[1, -1] = 1
    offset: Annotated[float, Meta(extra_json_schema={"unit": "rad"})] = 0.0
    """Position of the joint where the drive's is zero."""
    position: tuple[float, float] | None = None
    """Where the joint may stand, rad: lowest and highest."""
    velocity: Annotated[float, Meta(gt=0, le=1e5, extra_json_schema={"unit": "rad/s"})] = 10.0
    torque: Annotated[float, Meta(gt=0, le=1e5, extra_json_schema={"unit": "N.m"})] = 1.0
    acceleration: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s2"})] | None = None
    """Of the ramp; set-points jump without it."""
    valid_for: Seconds = 0.5
    """Seconds that a velocity or torque stands before the dead-man writes zero."""
    rate: Annotated[float, Meta(ge=1, le=1000, extra_json_schema={"unit": "Hz"})] = 50.0
    """Set-points, and requests for feedback where the drive must be asked, a second."""
    timeout: Seconds = 0.5
    """Silence after which the drive counts as lost."""
    feedback_timeout: Seconds | None = None
    """Age of position, velocity or state after which the motor is not controllable, although it is
    heard; five of the drive's own periods, and 0.25 s at least, without it."""
    torque_off_after: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})] | None = None
    """After a quick stop has begun, its torque is cut; without it the joint is held."""
    watchdog: Annotated[float, Meta(gt=0, le=60, extra_json_schema={"unit": "s"})] | bool = 0.5
    """Silence of the gateway after which the drive is to stop by itself; false leaves it alone."""
    optional: bool = False
    """It may be absent: while it was never heard, a stop is confirmed without it."""
    tolerance: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad"})] = 0.01
    """How near to its goal a move ends."""
    standstill: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s"})] = 0.05
    """Below which the joint counts as standing."""
    options: dict[str, Any] = {}
    """What the profile needs beside; see its table."""

    def __post_init__(self) -> None:
        if self.profile not in BUILTIN_PROFILES and ":" not in self.profile:
            known = ", ".join(BUILTIN_PROFILES)
            raise ValueError(
                f"`profile`: unknown {self.profile!r}; use one of {known}, or <module>:<NAME>"
            )
        if self.watchdog is True:
            raise ValueError("`watchdog` is a time in s, or false")
        if self.watchdog and self.watchdog * self.rate < _PERIODS_PER_WATCHDOG:
            raise ValueError(
                f"`watchdog` is shorter than {_PERIODS_PER_WATCHDOG} periods of `rate`, which reset it"
            )
        if self.position is not None and self.position[0] >= self.position[1]:
            raise ValueError("`position` is [lowest, highest], with lowest < highest")
