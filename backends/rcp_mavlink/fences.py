"""The on-board fence, to explain errors: an autopilot refuses targets outside it without a text."""

from __future__ import annotations

from rcp_mavlink.geo import distance
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.vehicle import Vehicle

__all__ = ["beyond", "crossing", "has_areas", "is_breached", "is_enabled", "is_united", "unknown"]

_GEOFENCE = 1 << 20  # of SYS_STATUS
_CEILING, _CIRCLE, _POLYGON, _FLOOR = 1, 2, 4, 8  # of FENCE_TYPE
_UNION = 2  # of FENCE_OPTIONS
_KEEPS_FENCES = 1 << 14  # MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
_WARNS = 1  # of GF_ACTION; 0 is none


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
    vehicle: Vehicle,
    parameters: Parameters,
    place: tuple[float, float],
    height: float,
    *,
    warns: bool = False,
) -> str | None:
    """Describe which height or radius a target surely violates; None if none.

    The polygons of a fence are on board only, where anybody may change them. A PX4 takes targets
    beyond a fence that only warns; with `warns`, that one counts too.
    """
    if vehicle.family.px4:
        action = _value(parameters, "GF_ACTION") or 0.0
        counts = action > 0 if warns else action > _WARNS
        return _beyond_px4(vehicle, parameters, place, height) if counts else None
    if not is_enabled(vehicle):
        return None
    kinds, away = _kinds(parameters), _from_home(vehicle, place)
    ceiling, floor = _value(parameters, "FENCE_ALT_MAX"), _value(parameters, "FENCE_ALT_MIN")
    radius = _value(parameters, "FENCE_RADIUS")
    if kinds & _CEILING and ceiling is not None and height > ceiling:
        return f"{height:g} m above home is above the fence, FENCE_ALT_MAX {ceiling:g} m"
    if kinds & _FLOOR and floor is not None and height < floor:
        return f"{height:g} m above home is below the fence, FENCE_ALT_MIN {floor:g} m"
    if kinds & _CIRCLE and radius is not None and away > radius:
        return f"{away:.0f} m from home is outside the fence, FENCE_RADIUS {radius:g} m"
    return None


def _beyond_px4(
    vehicle: Vehicle, parameters: Parameters, place: tuple[float, float], height: float
) -> str | None:
    """Describe what a target violates of PX4's limits, each of which is off at 0."""
    radius = _value(parameters, "GF_MAX_HOR_DIST") or 0.0
    ceiling = _value(parameters, "GF_MAX_VER_DIST") or 0.0
    away = _from_home(vehicle, place)
    if ceiling > 0 and height > ceiling:
        return f"{height:g} m above home is above the fence, GF_MAX_VER_DIST {ceiling:g} m"
    if radius > 0 and away > radius:
        return f"{away:.0f} m from home is outside the fence, GF_MAX_HOR_DIST {radius:g} m"
    return None


def has_areas(vehicle: Vehicle, parameters: Parameters) -> bool:
    """Return whether polygons and circles that were uploaded count now."""
    frame = vehicle.latest.get("AUTOPILOT_VERSION")
    if frame is not None and not frame.fields()["capabilities"] & _KEEPS_FENCES:
        return False
    if vehicle.family.px4:
        return bool(_value(parameters, "GF_ACTION"))
    return is_enabled(vehicle) and bool(_kinds(parameters) & _POLYGON)


def is_united(vehicle: Vehicle, parameters: Parameters) -> bool:
    """Return whether a vehicle may be in any area to stay in; otherwise it has to be in all."""
    options = _value(parameters, "FENCE_OPTIONS")
    return vehicle.family.px4 or bool(int(options or 0) & _UNION)


def unknown(vehicle: Vehicle, parameters: Parameters) -> str | None:
    """Describe what is not known of the fence, so that nobody can say what is inside; None if nothing."""
    if vehicle.family.px4:
        names = ["GF_ACTION"]
        if _value(parameters, "GF_ACTION"):
            names += ["GF_MAX_HOR_DIST", "GF_MAX_VER_DIST"]
        from_home = bool(_value(parameters, "GF_ACTION") and _value(parameters, "GF_MAX_HOR_DIST"))
    elif "SYS_STATUS" not in vehicle.latest:
        return "whether its fence is enabled"
    elif not is_enabled(vehicle):
        return None
    else:
        kinds = _kinds(parameters)
        flies = not vehicle.family.drives  # what drives has no limits of its height
        names = ["FENCE_TYPE"]
        names += ["FENCE_ALT_MAX"] if flies and kinds & _CEILING else []
        names += ["FENCE_ALT_MIN"] if flies and kinds & _FLOOR else []
        names += ["FENCE_RADIUS"] if kinds & _CIRCLE else []
        from_home = bool(kinds & _CIRCLE)
    missing = next((name for name in names if name not in parameters.known), None)
    if missing is None and from_home and vehicle.home is None:
        return "its home, from which its fence is measured,"
    return None if missing is None else f"the parameter {missing} of its fence"


def _from_home(vehicle: Vehicle, place: tuple[float, float]) -> float:
    return 0.0 if vehicle.home is None else distance(place, vehicle.home[:2])


def _value(parameters: Parameters, name: str) -> float | None:
    known = parameters.known.get(name)
    return None if known is None else known.value


def _kinds(parameters: Parameters) -> int:
    known = parameters.known.get("FENCE_TYPE")
    return _CEILING | _CIRCLE | _POLYGON if known is None else int(known.value)
