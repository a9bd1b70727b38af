"""The body and the controller of each kind of vehicle."""

from __future__ import annotations

from typing import Any

from rcp_mavlink_sim.copter.body import Quad
from rcp_mavlink_sim.copter.pilot import QuadPilot
from rcp_mavlink_sim.ground.body import Hull
from rcp_mavlink_sim.ground.pilot import GroundPilot
from rcp_mavlink_sim.kinds import Kind
from rcp_mavlink_sim.plane.body import Wing
from rcp_mavlink_sim.plane.pilot import PlanePilot

__all__ = ["body_of", "pilot_of"]

_PILOTS: dict[str, Any] = {
    "copter": QuadPilot,
    "plane": PlanePilot,
    "rover": GroundPilot,
    "boat": GroundPilot,
}


def body_of(kind: Kind) -> Any:
    """Return a body at rest."""
    if kind.name == "copter":
        return Quad()
    return Wing() if kind.name == "plane" else Hull(floats=kind.name == "boat")


def pilot_of(kind: Kind, body: Any) -> Any:
    """Return the controller of the body."""
    return _PILOTS[kind.name](body)
