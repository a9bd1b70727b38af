"""The modes of a plane: take-off, reposition, circle, return, land in a mission."""

from __future__ import annotations

import math

from rcp_mavlink_sim.flight import Flight
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.plane.pilot import PlanePilot
from rcp_mavlink_sim.state import VehicleState

__all__ = ["PlaneFlight"]

_APPROACH, _FINAL = 30.0, 300.0  # m above ground and to touchdown, final approach
_AHEAD = 120.0  # m ahead on the final approach, to which it steers
_FLARE, _TOUCH = 2.0, 0.7  # m above the ground, and the sink rate below, m/s
_FLOATS = 50.0  # m of flight during the flare
_SLOW = 1.3  # factor of the minimum airspeed, on the final approach
_AT_REST = 0.3  # m/s


class PlaneFlight(Flight):
    """The flight of a plane; like ArduPilot's, it lands only in missions."""

    starts_itself = True

    def __init__(self, vehicle: VehicleState) -> None:
        super().__init__(vehicle)
        self._final: tuple[tuple[float, float], float] | None = None
        """The landing point and the course."""

    @property
    def _pilot(self) -> PlanePilot:
        pilot = self._vehicle.pilot
        assert isinstance(pilot, PlanePilot)
        return pilot

    def limits(self) -> None:
        """Apply the speeds of the parameters."""
        p, pilot = self._vehicle.params, self._pilot
        pilot.limits.speed = p["AIRSPEED_CRUISE"]
        pilot.limits.up, pilot.limits.down = p["TECS_CLMB_MAX"], p["TECS_SINK_MAX"]
        pilot.circle, self.radius = abs(p["WP_LOITER_RAD"]), p["WP_RADIUS"]
        pilot.bank_most = math.radians(p["ROLL_LIMIT_DEG"])

    def enter(self, mode: Mode) -> None:
        """Enter a mode."""
        self._final = None
        super().enter(mode)

    def lead(self, dt: float) -> None:
        """Control the pilot for `dt` seconds in any mode except AUTO."""
        vehicle, pilot = self._vehicle, self._pilot
        if self.mode is Mode.TAKEOFF:
            if vehicle.body.landed and not self.taking_off:
                self.lift(vehicle.params["TKOFF_ALT"])
            elif self.taking_off and self.risen():
                height = pilot.depth
                pilot.hold()
                pilot.depth = height  # it climbs the last metres while it circles
        elif vehicle.kind.by_hand(self.mode):
            self._by_stick(self.mode)
        pilot.spinning = pilot.spinning or not vehicle.body.landed

    def _by_stick(self, mode: Mode) -> None:
        vehicle, pilot, sticks = self._vehicle, self._pilot, self._vehicle.sticks
        pilot.spinning = sticks.held or not vehicle.body.landed
        bank = sticks.roll * pilot.bank_most
        path = sticks.pitch * math.radians(20)
        power = (1 + sticks.throttle) / 2
        if mode in (Mode.FBWB, Mode.CRUISE):
            power = vehicle.body.power_for(0.5 * (pilot.limits.speed - vehicle.body.airspeed))
        pilot.by_hand = (bank, path, power)

    def take_off(self, height: float) -> bool:
        """Refuse: a plane takes off in TAKEOFF or in a mission."""
        return False

    def lift(self, height: float) -> None:
        """Run along the present heading and climb."""
        pilot, vehicle = self._pilot, self._vehicle
        pilot.reset()
        pilot.place, pilot.yaw, pilot.depth = None, vehicle.body.yaw, -height
        pilot.by_hand, pilot.idle = None, False
        pilot.spinning = self.taking_off = True

    def risen(self) -> bool:
        """Return whether the take-off has reached its height."""
        wanted = self._pilot.depth or 0.0
        if self._vehicle.body.d > wanted + 3:
            return False
        self.taking_off = False
        return True

    def begin_landing(self, place: tuple[float, float]) -> None:
        """Go to the start of the final approach, against the wind if there is any."""
        body, pilot = self._vehicle.body, self._pilot
        n, e = body.n - place[0], body.e - place[1]
        if math.hypot(body.wind_n, body.wind_e) > 1:
            n, e = body.wind_n, body.wind_e
        away = math.hypot(n, e) or 1.0
        entry = (place[0] + n / away * _FINAL, place[1] + e / away * _FINAL)
        pilot.place, pilot.depth, pilot.passes = entry, -_APPROACH, False
        self._final = (place, math.atan2(-e, -n))

    def come_down(self) -> bool:
        """Continue the landing of a mission; return whether it is complete."""
        body, pilot = self._vehicle.body, self._pilot
        if self._final is None:
            return False
        place, course = self._final
        if not self.mission.landing:
            along = abs(math.remainder(math.atan2(body.ve, body.vn) - course, math.tau)) < 0.5
            self.mission.landing = pilot.at_place(0.0) and along
            return False
        c, s = math.cos(course), math.sin(course)
        left = (place[0] - body.n) * c + (place[1] - body.e) * s
        pilot.place = (place[0] + c * (_AHEAD - left), place[1] + s * (_AHEAD - left))
        pilot.passes, pilot.limits.speed = True, self._vehicle.params["AIRSPEED_MIN"] * _SLOW
        if -body.d < _FLARE:
            pilot.depth, pilot.sinking, pilot.idle = None, _TOUCH, True
        else:
            pilot.depth = -max(_FLARE - 1, _APPROACH * (left - _FLOATS) / (_FINAL - _FLOATS))
        return body.landed and math.hypot(body.vn, body.ve) < _AT_REST

    def begin_return(self) -> None:
        """Leave the mission for RTL, as a mission item."""
        self.set_mode(Mode.RTL)

    def go_home(self) -> None:
        """Circle over home or over a nearer rally point."""
        vehicle, pilot = self._vehicle, self._pilot
        height = vehicle.params["RTL_ALTITUDE"]
        pilot.place, pilot.passes = vehicle.haven(), False
        pilot.depth = vehicle.body.d if height < 0 else -height

    def finished(self) -> None:
        """Go home at the end of a mission."""
        if not self._vehicle.body.landed:
            self._vehicle.send_text(5, "Mission complete, changing mode to RTL")
            self.set_mode(Mode.RTL)

    @property
    def landing(self) -> bool:
        """Whether it is landing."""
        return self.mode is Mode.AUTO and self.mission.landing

    def rest(self) -> None:
        """Stop the motor after a landing."""
        vehicle, pilot = self._vehicle, self._pilot
        if not vehicle.body.landed or self.taking_off:
            return
        rolls = self.landing and self.mission.running
        if not vehicle.kind.by_hand(self.mode) and not rolls:
            pilot.spinning = False
        delay = vehicle.params["LAND_DISARMDELAY"]
        at_rest = math.hypot(vehicle.body.vn, vehicle.body.ve) < _AT_REST
        done = self.mission.complete and self.mode is Mode.AUTO
        if done and at_rest and delay and self.landed_for >= delay:
            self.disarm()
