"""Where a vehicle is and where it should be."""

from __future__ import annotations

import math

from rcp_kernel.errors import InvalidValue, PreconditionFailed
from rcp_mavlink import messages as m
from rcp_mavlink.geo import distance, shifted
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.vehicle import Fix, Vehicle

__all__ = ["away", "fix_of", "located", "part", "place_of", "reach"]

_POSITION_TIMEOUT = 3.0  # s
_CIRCLE = 80.0  # m of radius, of a plane that does not say
_RADII = ("WP_LOITER_RAD", "NAV_LOITER_RAD")
_ROUND = 1.5  # radii off the place it circles round that count as there


async def located(vehicle: Vehicle) -> Fix:
    """Return where it is, after what was asked for a moment before has come."""
    await vehicle.until(lambda: vehicle.fix is not None, _POSITION_TIMEOUT)
    return fix_of(vehicle)


def fix_of(vehicle: Vehicle) -> Fix:
    """Return where it is.

    :raises PreconditionFailed: it does not know.
    """
    fix = vehicle.fix
    if fix is None:
        raise PreconditionFailed(
            "the vehicle has no position", remedy="Wait for GPS: see sensor/gps."
        )
    return fix


def place_of(vehicle: Vehicle, goal: m.MoveTo, fix: Fix) -> tuple[float, float]:
    """Return latitude and longitude of a goal, deg; those of `fix` where it names none."""
    metres = goal.north is not None or goal.east is not None
    degrees = goal.latitude is not None or goal.longitude is not None
    if metres and degrees:
        raise InvalidValue("give latitude and longitude, or north and east, not both")
    if degrees:
        if goal.latitude is None or goal.longitude is None:
            raise InvalidValue("latitude and longitude must be given together")
        return goal.latitude, goal.longitude
    if not metres:
        return fix.lat, fix.lon
    home = vehicle.home
    if home is None:
        raise PreconditionFailed("move_to: home is not known yet")
    return shifted(goal.north or 0.0, goal.east or 0.0, home[:2])


def away(vehicle: Vehicle, fix: Fix, lat: float, lon: float, altitude: float) -> float:
    """Return how far off a place is, m; height is nothing to what drives."""
    flat = distance((fix.lat, fix.lon), (lat, lon))
    return flat if vehicle.family.drives else math.hypot(flat, fix.height - altitude)


def reach(vehicle: Vehicle, parameters: Parameters, near: float) -> float:
    """Return how far off a place counts as there, m."""
    if not vehicle.family.circles:
        return near
    known = (parameters.known.get(name) for name in _RADII)
    radius = next((abs(p.value) for p in known if p is not None and p.value), _CIRCLE)
    return max(near, radius * _ROUND)


def part(done: float, whole: float) -> float:
    """Return a fraction between 0 and 1."""
    return min(1.0, max(0.0, done / whole)) if whole > 0 else 1.0
