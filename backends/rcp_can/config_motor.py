"""The configuration of one motor: drive, transmission and limits."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from rcp_can.config_names import BusName, Seconds

__all__ = ["BUILTIN_PROFILES", "MotorConfig"]

BUILTIN_PROFILES = (
    "cia402", "odrive", "mit", "tmotor", "damiao", "moteus", "vesc", "cybergear", "dronecan"
)  # fmt: skip
"""Profiles that come with the backend."""
_NODES = {
    "cia402": ("CiA 402", 1, 127),  # CiA 301: 7 bits, 0 is all nodes
    "dronecan": ("DroneCAN", 1, 127),
    "odrive": ("ODrive", 0, 63),  # 6 bits beside the command
    "moteus": ("moteus", 0, 127),
    "vesc": ("VESC", 0, 255),
    "cybergear": ("CyberGear", 0, 255),
}
"""The maker's name, and the lowest and highest id of a node, where a profile has fewer than CAN."""
_PERIODS_PER_WATCHDOG = 3  # set-points per watchdog period, because some may be lost
Positive = Annotated[float, Meta(gt=0, le=1e6)]


class MotorConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One motor. Limits apply at the joint, after the gear."""

    bus: BusName
    profile: Annotated[str, Meta(max_length=200)]
    """A built-in profile, or `module:NAME` of a third-party one."""
    node: Annotated[int, Meta(ge=0, le=0x7FF)]
    gear: Positive = 1.0
    """Turns of the drive's shaft per turn of the joint."""
    direction: Literal[1, -1] = 1
    offset: Annotated[float, Meta(extra_json_schema={"unit": "rad"})] = 0.0
    """Position of the joint at the drive's zero."""
    position: tuple[float, float] | None = None
    """Range of the joint, rad: lowest and highest."""
    velocity: Annotated[float, Meta(gt=0, le=1e5, extra_json_schema={"unit": "rad/s"})] = 10.0
    torque: Annotated[float, Meta(gt=0, le=1e5, extra_json_schema={"unit": "N.m"})] = 1.0
    acceleration: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s2"})] | None = None
    """Acceleration of the ramp; without it, set-points are applied in one step."""
    valid_for: Seconds = 0.5
    """Validity of a velocity or torque in s, before the dead-man writes zero."""
    rate: Annotated[float, Meta(ge=1, le=1000, extra_json_schema={"unit": "Hz"})] = 50.0
    """Rate of set-points, and of polling for drives that must be polled."""
    timeout: Seconds = 0.5
    """Time without messages after which the drive counts as lost."""
    feedback_timeout: Seconds | None = None
    """Age of position, velocity or state beyond which the motor is not controllable although other
    messages arrive; by default five of the drive's own periods, at least 0.25 s."""
    torque_off_after: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})] | None = None
    """Time from the start of a quick stop until the torque is cut; without it the joint is held."""
    watchdog: Annotated[float, Meta(gt=0, le=60, extra_json_schema={"unit": "s"})] | bool = 0.5
    """Time without messages after which the drive stops by itself; false keeps the drive's
    setting."""
    optional: bool = False
    """The motor may be absent: a stop is confirmed without it until its first message."""
    tolerance: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad"})] = 0.01
    """Position tolerance of a move."""
    standstill: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s"})] = 0.05
    """Speed below which the joint counts as at rest."""
    gravity: tuple[tuple[float, float], ...] = ()
    """Torque that holds the joint against gravity: pairs of position (rad) and torque (N·m), which is
    fed forward to the drive."""
    commissioning: bool = False
    """Offer what sets up and measures the drive: its procedures, step response and chirp."""
    options: dict[str, Any] = {}
    """Options of the profile, listed in its table."""

    def __post_init__(self) -> None:
        if self.profile not in BUILTIN_PROFILES and ":" not in self.profile:
            known = ", ".join(BUILTIN_PROFILES)
            raise ValueError(
                f"`profile`: unknown {self.profile!r}; use one of {known}, or <module>:<NAME>"
            )
        name, lowest, highest = _NODES.get(self.profile, ("CAN", 0, 0x7FF))
        if not lowest <= self.node <= highest:
            raise ValueError(
                f"`node`: {self.node} is not a valid {name} node id ({lowest} to {highest})"
            )
        if self.watchdog is True:
            raise ValueError("`watchdog` must be a time in s, or false")
        if self.watchdog and self.watchdog * self.rate < _PERIODS_PER_WATCHDOG:
            raise ValueError(
                f"`watchdog` is shorter than {_PERIODS_PER_WATCHDOG} periods of `rate`, which reset it"
            )
        places = [place for place, _ in self.gravity]
        if self.gravity and (len(places) < 2 or places != sorted(set(places))):
            raise ValueError("`gravity` is two pairs or more, by increasing positions")
        if any(abs(torque) > self.torque for _, torque in self.gravity):
            raise ValueError("`gravity` has a torque that exceeds `torque`")
        if self.position is not None and self.position[0] >= self.position[1]:
            raise ValueError("`position` must be [lowest, highest], with lowest < highest")
