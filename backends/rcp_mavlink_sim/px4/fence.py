"""PX4's geofence: a radius and a height from home, uploaded areas, and what it does beyond them."""

from __future__ import annotations

from rcp_mavlink.geo import distance
from rcp_mavlink_sim.fence import Fence, Point
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.px4.flight import HOLD

__all__ = ["Px4Fence"]

_HEIGHT, _RADIUS, _AREA = 1, 2, 4
_TERMINATE = 4
_MODES = {2: HOLD, 3: Mode.RTL, 5: Mode.LAND}
"""By GF_ACTION; 0 does nothing, 1 warns."""
_TAKES_ANY = (0, 1)
"""The actions with which it may be sent anywhere."""
_KILL = 21196.0


class Px4Fence(Fence):
    """The fence, and whether the vehicle violates it."""

    @property
    def united(self) -> bool:
        """Whether one area to stay in is enough."""
        return True

    def crossed(self, place: Point, height: float) -> int:
        """Return what a position (deg) and height above home (m) violate."""
        params, home = self._vehicle.params, self._vehicle.home
        radius, ceiling = params["GF_MAX_HOR_DIST"], params["GF_MAX_VER_DIST"]
        found = _HEIGHT if ceiling > 0 and height > ceiling else 0
        if radius > 0 and home is not None and distance(place, home[:2]) > radius:
            found |= _RADIUS
        return found | (0 if self._inside(place) else _AREA)

    def allows(self, place: Point, height: float) -> bool:
        """Return whether the vehicle may be sent somewhere."""
        return self._vehicle.params["GF_ACTION"] in _TAKES_ANY or not self.crossed(place, height)

    def check(self) -> None:
        """Check for violations; report new ones and act on them."""
        vehicle = self._vehicle
        action = int(vehicle.params["GF_ACTION"])
        if not action or vehicle.home is None:
            self.breached = 0
            return
        now = self.crossed(vehicle.geographic(), -vehicle.body.d)
        new, self.breached = now & ~self.breached, now
        if not new or not vehicle.armed:
            return
        self.count += 1
        vehicle.send_text(4, "Geofence exceeded")
        to = _MODES.get(action)
        if action == _TERMINATE:
            self._flight.disarm(_KILL)
        elif to is not None and self._flight.mode not in (to, Mode.LAND):
            vehicle.send_text(2, "Failsafe activated: Geofence exceeded")
            self._flight.enter(to if self._flight.refusal(to) is None else Mode.LAND)
