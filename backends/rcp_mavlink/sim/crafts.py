"""Of what a vehicle of each kind is made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rcp_mavlink.sim.copter import CopterFlight, Quad, QuadPilot
from rcp_mavlink.sim.ground import GroundFlight, GroundPilot, Hull
from rcp_mavlink.sim.plane import PlaneFlight, PlanePilot, Wing

if TYPE_CHECKING:
    from rcp_mavlink.sim.kinds import Kind
    from rcp_mavlink.sim.vehicle import Vehicle

__all__ = ["body_of", "flight_of", "pilot_of"]

_FLIGHTS = {
    "copter": CopterFlight,
    "plane": PlaneFlight,
    "rover": GroundFlight,
    "boat": GroundFlight,
}
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
    """Return what steers the body."""
    return _PILOTS[kind.name](body)


def flight_of(vehicle: Vehicle) -> Any:
    """Return what leads the pilot."""
    return _FLIGHTS[vehicle.kind.name](vehicle)
