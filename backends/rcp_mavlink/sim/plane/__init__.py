"""A fixed-wing aircraft."""

from __future__ import annotations

from rcp_mavlink.sim.plane.body import Wing
from rcp_mavlink.sim.plane.flight import PlaneFlight
from rcp_mavlink.sim.plane.pilot import PlanePilot

__all__ = ["PlaneFlight", "PlanePilot", "Wing"]
