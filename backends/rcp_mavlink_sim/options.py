"""What a twin is made with."""

from __future__ import annotations

from typing import Literal

import msgspec

__all__ = ["Options"]


class Options(msgspec.Struct, frozen=True, kw_only=True):
    """One simulated vehicle."""

    vehicle: Literal["copter", "plane", "rover", "boat"] = "copter"
    system: int = 1
    """MAVLink system id; its component is 1, the autopilot."""
    home: tuple[float, float, float] = (-35.3632621, 149.1652374, 584.0)
    """Latitude, longitude (deg) and height above sea level (m) of where it stands at first."""
    heading: float = 0.0
    """Where it looks at first, deg."""
    speed: float = 1.0
    """Simulated seconds in a real one. Rates of messages and the time-outs for a ground station
    that falls silent are in real time whatever it is."""
    warmup: float = 40.0
    """Simulated seconds from boot until it can be armed in a mode that flies by position."""
    charge: float = 1.0
    """Of the battery at first, 0…1."""
    capacity: float = 3300.0
    """Of the battery, mAh."""
    wind: tuple[float, float] = (0.0, 0.0)
    """Where it blows to, m/s north and east."""
    noise: float = 1.0
    """Of the sensors, times the usual one; 0 has none."""
    seed: int = 0
    """Of the noise."""
    parameters: dict[str, float] = {}
    """Other values than usual."""
    streaming: bool = False
    """Send the usual telemetry at 4 Hz unasked; a real one waits to be asked."""
    latency: float = 0.0
    """Real seconds that whatever it sends is on its way, as over a slow radio."""
    key: bytes | None = None
    """32 bytes: sign what is sent, and take only what is signed with it."""
