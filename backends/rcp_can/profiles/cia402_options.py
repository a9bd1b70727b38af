"""The options of a CiA 402 drive."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Meta, Struct

__all__ = ["Cia402Options"]


class Cia402Options(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The drive's own units, and its communication."""

    counts: Annotated[float, Meta(gt=0)] = 4096.0
    """Position units per turn of the shaft."""
    velocity_scale: Annotated[float, Meta(gt=0)] = 1.0
    """Velocity units per position unit per second."""
    acceleration_scale: Annotated[float, Meta(gt=0)] | None = None
    """Acceleration units per position unit per second squared; None: velocity units per second."""
    rated_torque: Annotated[float, Meta(gt=0)] = 1.0
    """N·m; torques are given in thousandths of it."""
    control: Literal["profile", "cyclic"] = "profile"
    """Profile position and velocity, or the cyclic synchronous modes."""
    homing_method: Annotated[int, Meta(ge=-128, le=127)] = 35
    """Method number of CiA 402-2; 35 and 37 use the current position."""
    feedback: Annotated[int, Meta(ge=1, le=10_000)] = 20
    """Period of the drive's PDOs, ms."""
    sync: Annotated[int, Meta(ge=0, le=10_000)] = 0
    """Period of SYNC, ms, which then triggers the drive's PDOs; 0 sends none."""
    heartbeat: Annotated[int, Meta(ge=0, le=10_000)] = 100
    """Period of the drive's heartbeat, ms; 0 keeps the drive's setting."""
    on_silence: Literal["quick_stop", "disable_voltage", "fault"] = "quick_stop"
    """Reaction of the drive to a lost gateway heartbeat (0x6007)."""
    quick_stop: Annotated[int, Meta(ge=0, le=8)] | None = 6
    """Quick stop option (0x605A): 5 to 8 brake and hold torque, 0 to 4 end without torque; 6
    brakes on the
    quick stop ramp and holds. None keeps the drive's setting."""
    master: Annotated[int, Meta(ge=1, le=127)] = 126
    """Node id of the gateway's own heartbeat."""
    map_pdos: bool = True
    """Map the PDOs; otherwise the mapping of `eds`, or this one, is assumed to be active."""
    eds: str = ""
    """The drive's EDS, whose mapping is used with `map_pdos = false`."""
    home_timeout: Annotated[float, Meta(gt=0)] = 60.0
    """Time for homing, s."""

    def __post_init__(self) -> None:
        if self.eds and self.map_pdos:
            raise ValueError("`eds` requires `map_pdos = false`")

    @property
    def positions(self) -> float:
        """Position units per rad of the shaft."""
        return self.counts / (2 * math.pi)

    @property
    def velocities(self) -> float:
        """Velocity units per rad/s of the shaft."""
        return self.positions * self.velocity_scale

    @property
    def accelerations(self) -> float:
        """Acceleration units per rad/s² of the shaft."""
        scale = self.acceleration_scale
        return self.positions * (self.velocity_scale if scale is None else scale)
