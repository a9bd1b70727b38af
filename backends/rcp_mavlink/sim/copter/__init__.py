"""A quadrotor."""

from __future__ import annotations

from rcp_mavlink.sim.copter.body import Quad
from rcp_mavlink.sim.copter.flight import CopterFlight
from rcp_mavlink.sim.copter.pilot import QuadPilot

__all__ = ["CopterFlight", "Quad", "QuadPilot"]
