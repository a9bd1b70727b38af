"""The geofence: height limits, a circle around home, uploaded polygons and circles."""

from __future__ import annotations

import math

from rcp_mavlink.geo import distance
from rcp_mavlink_sim.flight import Flight
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.plans import Plan
from rcp_mavlink_sim.state import VehicleState
from rcp_mavlink_sim.wire import mav

__all__ = ["Fence", "Point"]

_CEILING, _CIRCLE, _POLYGON, _FLOOR = 1, 2, 4, 8
_LAND, _BRAKE = 2, 4  # FENCE_ACTION
_UNION = 2  # of FENCE_OPTIONS
_NAMES = {_CEILING: "Max Alt", _CIRCLE: "Circle", _POLYGON: "Polygon", _FLOOR: "Min Alt"}
Point = tuple[float, float]


class Fence:
    """The fences, and whether the vehicle violates them."""

    def __init__(self, vehicle: VehicleState, flight: Flight) -> None:
        self._vehicle, self._flight = vehicle, flight
        self.plan = Plan(mav.MAV_MISSION_TYPE_FENCE)
        self.breached = 0
        """The fences violated now, as bits of FENCE_TYPE."""
        self.count = 0

    def crossed(self, place: Point, height: float) -> int:
        """Return the fences that a position (deg) and height above home (m) violate."""
        params, home = self._vehicle.params, self._vehicle.home
        kinds, found = int(params["FENCE_TYPE"]), 0
        if kinds & _CEILING and height > params["FENCE_ALT_MAX"]:
            found |= _CEILING
        if kinds & _FLOOR and height < params["FENCE_ALT_MIN"]:
            found |= _FLOOR
        if (
            kinds & _CIRCLE
            and home is not None
            and distance(place, home[:2]) > params["FENCE_RADIUS"]
        ):
            found |= _CIRCLE
        if kinds & _POLYGON and not self._inside(place):
            found |= _POLYGON
        return found

    def check(self) -> None:
        """Check for violations; report new ones and act on them."""
        vehicle = self._vehicle
        if not vehicle.params["FENCE_ENABLE"] or vehicle.home is None:
            self.breached = 0
            return
        now = self.crossed(vehicle.geographic(), -vehicle.body.d)
        new, over = now & ~self.breached, self.breached and not now
        self.breached = now
        if over:
            vehicle.send_text(5, "Fence breach cleared")
        if new and vehicle.armed:
            self.count += 1
            names = " and ".join(name for bit, name in _NAMES.items() if new & bit)
            vehicle.send_text(4, f"{names} fence breached")
            self._act(int(vehicle.params["FENCE_ACTION"]))

    def _act(self, action: int) -> None:
        """Apply FENCE_ACTION: nothing, return home, land, or brake."""
        vehicle = self._vehicle
        if not action:
            return
        if vehicle.body.landed and vehicle.kind.flies:
            self._flight.disarm()
            return
        brake = Mode.BRAKE if action == _BRAKE and vehicle.kind.name == "copter" else None
        self._flight.retreat(return_home=action not in (_LAND, _BRAKE), to=brake)

    @property
    def united(self) -> bool:
        """Whether one area to stay in is enough; otherwise it has to be in all."""
        return bool(int(self._vehicle.params["FENCE_OPTIONS"]) & _UNION)

    def _inside(self, place: Point) -> bool:
        items, at = self.plan.items, 0
        inner: list[bool] = []
        while at < len(items):
            item = items[at]
            centre = (item.lat, item.lon)
            if item.command in (5001, 5002):
                corners = [(i.lat, i.lon) for i in items[at : at + max(1, int(item.params[0]))]]
                within = _in_polygon(place, corners)
                at += len(corners)
            elif item.command in (5003, 5004):
                within = distance(place, centre) <= item.params[0]
                at += 1
            else:
                at += 1
                continue
            if item.command in (5002, 5004):
                if within:
                    return False
            else:
                inner.append(within)
        return not inner or (any(inner) if self.united else all(inner))


def _in_polygon(place: Point, corners: list[Point]) -> bool:
    inside = False
    for (a_lat, a_lon), (b_lat, b_lon) in zip(corners, corners[1:] + corners[:1], strict=True):
        if (a_lat > place[0]) != (b_lat > place[0]):
            at = a_lon + (place[0] - a_lat) / (b_lat - a_lat) * (b_lon - a_lon)
            if place[1] < at and math.isfinite(at):
                inside = not inside
    return inside
