"""The options of a simulated vehicle."""

from __future__ import annotations

from typing import Literal

import msgspec

__all__ = ["Box", "Options"]


class Box(msgspec.Struct, frozen=True):
    """A square box that stands on the ground, for the camera to see."""

    latitude: float
    longitude: float
    side: float
    """m"""
    height: float
    """m"""


class Options(msgspec.Struct, frozen=True, kw_only=True):
    """One simulated vehicle."""

    vehicle: Literal["copter", "plane", "rover", "boat", "px4"] = "copter"
    """All with ArduPilot, but `px4`, a copter with PX4."""
    system: int = 1
    """MAVLink system id; its component is 1, the autopilot."""
    home: tuple[float, float, float] = (-35.3632621, 149.1652374, 584.0)
    """Latitude, longitude (deg) and height above sea level (m) of the start."""
    heading: float = 0.0
    """Initial heading, deg."""
    speed: float = 1.0
    """Simulated seconds per real second. Message rates and the time-outs for a silent ground
    station are always in real time."""
    warmup: float = 40.0
    """Simulated seconds from boot until it can be armed in a mode that needs a position."""
    charge: float = 1.0
    """Initial charge of the battery, 0…1."""
    capacity: float = 3300.0
    """Capacity of the battery, mAh."""
    wind: tuple[float, float] = (0.0, 0.0)
    """Direction it blows towards, m/s north and east."""
    noise: float = 1.0
    """Scale of the sensor noise; 0 disables it."""
    seed: int = 0
    """Seed of the noise."""
    boxes: tuple[Box, ...] = ()
    """What stands on the ground near it."""
    parameters: dict[str, float] = {}
    """Parameters that differ from their defaults."""
    streaming: bool = False
    """Whether to send telemetry at 4 Hz without a request; a real vehicle waits for one."""
    latency: float = 0.0
    """Delay of everything it sends, real seconds, as over a slow radio."""
    key: bytes | None = None
    """Key of 32 bytes: messages are signed, and only messages signed with it are accepted."""
