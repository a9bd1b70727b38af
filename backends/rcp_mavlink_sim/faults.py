"""Faults that tests inject: link, in each direction, autopilot, telemetry, power."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Faults"]


@dataclass(slots=True)
class Faults:
    """Set any of them at any time, on `vehicle.faults`; resetting it repairs the fault."""

    uplink_cut: bool = False
    """Messages of ground stations are lost; telemetry continues."""
    downlink_cut: bool = False
    """Messages of the vehicle are lost; it still obeys."""
    frozen: bool = False
    """The autopilot hangs: it receives and sends nothing and its failsafes do not act, while its
    outputs keep their values and the body moves on. Messages received meanwhile are lost."""
    telemetry: Literal["live", "silent", "stale"] = "live"
    """Heartbeats and replies continue, but other messages are not sent (`silent`), or repeat their
    values and time stamps from the start of the fault (`stale`)."""
    storage_full: bool = False
    """An upload of a plan ends with an error at its last item, which is not kept; an ArduPilot has
    replaced the items of a mission before it, but a fence is that of before."""
    powerless: bool = False
    """The motors stop without the autopilot knowing: a copter falls, a plane glides."""
