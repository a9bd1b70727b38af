"""What a test breaks of a twin: its link, in each direction, its autopilot, its telemetry, its power."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Faults"]


@dataclass(slots=True)
class Faults:
    """Set any of them at any time, on `vehicle.faults`; setting it back mends it."""

    uplink_cut: bool = False
    """What ground stations send is lost; telemetry goes on."""
    downlink_cut: bool = False
    """What the vehicle sends is lost; it obeys all the same."""
    frozen: bool = False
    """The autopilot hangs: it takes nothing, sends nothing and watches over nothing, while its
    outputs stay as they are and the body goes on with them. What came meanwhile is lost."""
    telemetry: Literal["live", "silent", "stale"] = "live"
    """Heartbeats and answers go on, and all else is not sent (`silent`), or is sent as it was when
    this began, with the time stamps of then (`stale`)."""
    powerless: bool = False
    """No motor turns, and the autopilot does not know: a copter falls, a plane glides."""
