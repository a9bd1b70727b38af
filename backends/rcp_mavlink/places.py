"""The position of a vehicle and of its target."""

from __future__ import annotations

import math

from msgspec.structs import replace

from rcp_kernel.errors import InvalidValue, PreconditionFailed
from rcp_kernel.types import PoseStamped
from rcp_mavlink import enu
from rcp_mavlink import messages as m
from rcp_mavlink.geo import distance, shifted
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.vehicle import Fix, Vehicle

__all__ = ["away", "fix_of", "located", "native_goal", "part", "place_of", "pose_of", "reach"]

_POSITION_TIMEOUT = 3.0  # s
_CIRCLE = 80.0  # m, radius assumed for a plane that does not report one
_RADII = ("WP_LOITER_RAD", "NAV_LOITER_RAD")
_FRAME = "map"
_NEAR, _NEAR_ALOFT = 1.0, 0.5  # m from the target that count as arrived; a rover stops farther off
_ROUND = 1.5  # radii from the centre of the circle that count as arrived


async def located(vehicle: Vehicle) -> Fix:
    """Return the position, after the arrival of one that was just requested."""
    await vehicle.until(lambda: vehicle.fix is not None, _POSITION_TIMEOUT)
    return fix_of(vehicle)


def fix_of(vehicle: Vehicle) -> Fix:
    """Return the position.

    :raises PreconditionFailed: the vehicle has no position.
    """
    fix = vehicle.fix
    if fix is None:
        raise PreconditionFailed(
            "the vehicle has no position",
            remedy="Wait until sensor/pose has a value: its estimator needs a fix (sensor/gps), and some "
            "seconds after the start.",
        )
    return fix


def place_of(vehicle: Vehicle, goal: m.MoveTo, fix: Fix) -> tuple[float, float]:
    """Return latitude and longitude of a goal, deg; of `fix` if the goal has none."""
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


def native_goal(vehicle: Vehicle, goal: m.MoveTo) -> m.MoveTo:
    """Return a goal in the map as latitude, longitude and height with a heading from north.

    :raises InvalidValue: its frame is not the map, or it names another target as well.
    """
    tolerance = goal.tolerance
    if goal.position is None:
        return replace(goal, tolerance=_NEAR if tolerance is None else tolerance)
    if goal.frame != _FRAME:
        raise InvalidValue(
            f"move_to: the vehicle has no frame '{goal.frame}'",
            remedy="Give the position in `map`: metres east, north and up from home.",
            details={"pointer": "/frame"},
        )
    others = (goal.latitude, goal.longitude, goal.north, goal.east, goal.altitude)
    if any(other is not None for other in others):
        raise InvalidValue("give `position`, or another target, not both")
    if tolerance is None:
        tolerance = _NEAR if vehicle.family.drives else _NEAR_ALOFT
    home, at = vehicle.home, goal.position
    if home is None:
        raise PreconditionFailed("move_to: home is not known yet")
    lat, lon, height = enu.there(at.x, at.y, at.z or 0.0, home)
    return m.MoveTo(
        latitude=lat,
        longitude=lon,
        altitude=None if at.z is None else height,
        yaw=None if goal.yaw is None else enu.heading(goal.yaw),
        speed=goal.speed,
        tolerance=tolerance,
    )


def pose_of(vehicle: Vehicle, fix: Fix, heading: float | None) -> PoseStamped:
    """Return the position and heading in the map.

    :raises PreconditionFailed: home is not known.
    """
    home = vehicle.home
    if home is None:
        raise PreconditionFailed("home is not known yet")
    where = enu.place(fix.lat, fix.lon, fix.height, home)
    return PoseStamped(where, enu.flat(heading or 0.0), _FRAME)


def away(vehicle: Vehicle, fix: Fix, lat: float, lon: float, altitude: float) -> float:
    """Return the distance to a target, m; ground vehicles ignore height."""
    flat = distance((fix.lat, fix.lon), (lat, lon))
    return flat if vehicle.family.drives else math.hypot(flat, fix.height - altitude)


def reach(vehicle: Vehicle, parameters: Parameters, near: float) -> float:
    """Return the distance from a target that counts as arrived, m."""
    if not vehicle.family.circles:
        return near
    known = (parameters.known.get(name) for name in _RADII)
    radius = next((abs(p.value) for p in known if p is not None and p.value), _CIRCLE)
    return max(near, radius * _ROUND)


def part(done: float, whole: float) -> float:
    """Return a fraction between 0 and 1."""
    return min(1.0, max(0.0, done / whole)) if whole > 0 else 1.0
