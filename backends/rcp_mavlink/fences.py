"""The on-board fence, to explain errors: an autopilot refuses targets outside it without a text."""

from __future__ import annotations

from rcp_mavlink.geo import distance
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.vehicle import Vehicle

__all__ = ["beyond", "crossing", "is_breached", "is_enabled"]

_GEOFENCE = 1 << 20  # of SYS_STATUS
_CEILING, _CIRCLE, _POLYGON, _FLOOR = 1, 2, 4, 8  # of FENCE_TYPE


def is_enabled(vehicle: Vehicle) -> bool:
    """Return whether the vehicle reports that its fence is enabled."""
    return bool(_bits(vehicle, "enabled"))


def is_breached(vehicle: Vehicle) -> bool:
    """Return whether the vehicle reports that it is outside its fence."""
    return is_enabled(vehicle) and not _bits(vehicle, "health")


def _bits(vehicle: Vehicle, which: str) -> int:
    frame = vehicle.latest.get("SYS_STATUS")
    fields = {} if frame is None else frame.fields()
    return fields.get(f"onboard_control_sensors_{which}", 0) & _GEOFENCE


def crossing(
    vehicle: Vehicle, parameters: Parameters, place: tuple[float, float], height: float
) -> str | None:
    """Describe which fence a refused target (deg) at a height above home (m) may violate."""
    why = beyond(vehicle, parameters, place, height)
    if why is None and is_enabled(vehicle) and _kinds(parameters) & _POLYGON:
        return "its fence is enabled, and the target is probably outside it"
    return why


def beyond(
    vehicle: Vehicle, parameters: Parameters, place: tuple[float, float], height: float
) -> str | None:
    """Describe which height or radius a target surely violates; None if none.

    The polygons of a fence are on board only, where anybody may change them.
    """

    def value(name: str) -> float | None:
        known = parameters.known.get(name)
        return None if known is None else known.value

    if not is_enabled(vehicle):
        return None
    home, kinds = vehicle.home, _kinds(parameters)
    ceiling, floor = value("FENCE_ALT_MAX"), value("FENCE_ALT_MIN")
    radius, away = value("FENCE_RADIUS"), 0.0 if home is None else distance(place, home[:2])
    if kinds & _CEILING and ceiling is not None and height > ceiling:
        return f"{height:g} m above home is above the fence, FENCE_ALT_MAX {ceiling:g} m"
    if kinds & _FLOOR and floor is not None and height < floor:
        return f"{height:g} m above home is below the fence, FENCE_ALT_MIN {floor:g} m"
    if kinds & _CIRCLE and radius is not None and away > radius:
        return f"{away:.0f} m from home is outside the fence, FENCE_RADIUS {radius:g} m"
    return None


def _kinds(parameters: Parameters) -> int:
    known = parameters.known.get("FENCE_TYPE")
    return _CEILING | _CIRCLE | _POLYGON if known is None else int(known.value)
