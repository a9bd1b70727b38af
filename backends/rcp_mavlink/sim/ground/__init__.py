"""A rover, and a boat that differs from it in how it lies in its water."""

from __future__ import annotations

from rcp_mavlink.sim.ground.body import Hull
from rcp_mavlink.sim.ground.flight import GroundFlight
from rcp_mavlink.sim.ground.pilot import GroundPilot

__all__ = ["GroundFlight", "GroundPilot", "Hull"]
