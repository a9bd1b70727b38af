"""The modes of a copter: take-off, reposition, hold, return, land, set-points, manual control."""

from __future__ import annotations

import math

from rcp_mavlink_sim.flight import Flight
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.state import VehicleState

__all__ = ["CopterFlight"]

_ON_THE_FLOOR = 1.0  # s until it counts as landed
_HIGHEST_WITHOUT_CLIMB = 2.0  # m
_FACES_IT = 1  # FOLL_YAW_BEHAVE
_BY_STICK = (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER, Mode.POSHOLD)


class CopterFlight(Flight):
    """The flight of a copter."""

    paced = frozenset({Mode.GUIDED, Mode.AUTO, Mode.RTL, Mode.FOLLOW})

    def __init__(self, vehicle: VehicleState) -> None:
        super().__init__(vehicle)
        self._waited = 0.0
        self._steered = False
        self._centre, self._angle = (0.0, 0.0), 0.0

    def limits(self) -> None:
        """Apply the speeds of the parameters."""
        p, limits = self._vehicle.params, self._vehicle.pilot.limits
        limits.speed = p["WPNAV_SPEED"] / 100
        limits.up, limits.down = p["WPNAV_SPEED_UP"] / 100, p["WPNAV_SPEED_DN"] / 100
        limits.acceleration = p["WPNAV_ACCEL"] / 100
        limits.climb_acceleration = p["WPNAV_ACCEL_Z"] / 100 * 1.5
        self.radius = max(0.5, p["WPNAV_RADIUS"] / 100)
        self.patience = p["GUID_TIMEOUT"]

    def apply_parameters(self) -> None:
        """Apply changed parameters, except the speeds in GUIDED and FOLLOW, which keep those that they began with."""
        if self.mode in (Mode.GUIDED, Mode.FOLLOW):
            self.patience = self._vehicle.params["GUID_TIMEOUT"]
        else:
            super().apply_parameters()

    @property
    def faces_travel(self) -> bool:
        """Whether it faces the direction of travel by default."""
        return bool(self._vehicle.params["WP_YAW_BEHAVIOR"])

    def refusal(self, mode: Mode) -> str | None:
        """Return why a mode cannot be entered now; None if it can."""
        vehicle = self._vehicle
        landed = vehicle.armed and vehicle.body.landed
        if mode is Mode.AUTO and landed and self.mission.flyable and not self.mission.takes_off:
            return "Auto: Missing Takeoff Cmd"
        if mode is Mode.FOLLOW and not vehicle.params["FOLL_ENABLE"]:
            return "Set FOLL_ENABLE = 1"
        return super().refusal(mode)

    def take_off(self, height: float) -> bool:
        """Climb to a height above home, m; return whether this is possible now."""
        vehicle = self._vehicle
        ready = vehicle.armed and vehicle.body.landed and self.mode is Mode.GUIDED
        if not ready or not math.isfinite(height) or height <= 0:
            return False
        self._become("takeoff")
        self.lift(height)
        return True

    def lift(self, height: float) -> None:
        """Take off vertically."""
        pilot, body = self._vehicle.pilot, self._vehicle.body
        pilot.reset()
        pilot.place, pilot.velocity = (body.n, body.e), (0.0, 0.0)
        pilot.depth = -height
        pilot.spinning = self.taking_off = True

    def risen(self) -> bool:
        """Return whether the take-off has reached its height."""
        if not self._vehicle.pilot.at_place(0.5):
            return False
        self.taking_off = False
        return True

    def lead(self, dt: float) -> None:
        """Control the pilot for `dt` seconds in any mode except AUTO."""
        match self.mode:
            case Mode.GUIDED:
                if self.taking_off and self._vehicle.pilot.at_place(0.3):
                    self.taking_off = False
            case Mode.RTL:
                self._return(dt)
            case Mode.LAND:
                self.descend()
            case Mode.CIRCLE:
                self._circle(dt)
            case Mode.FOLLOW:
                self._follow()
            case mode if mode in _BY_STICK:
                self._by_stick(mode)
            case _:
                pass

    def enter(self, mode: Mode) -> None:
        """Enter a mode; the centre of a circle is ahead by its radius."""
        super().enter(mode)
        self._vehicle.leader.forget_offset()
        self._vehicle.pilot.most = None
        if mode is Mode.CIRCLE:
            body, radius = self._vehicle.body, self._vehicle.params["CIRCLE_RADIUS"] / 100
            self._centre = (
                body.n + radius * math.cos(body.yaw),
                body.e + radius * math.sin(body.yaw),
            )
            self._angle = body.yaw + math.pi

    def _circle(self, dt: float) -> None:
        """Go round, and face the centre (`AC_Circle`)."""
        pilot, p = self._vehicle.pilot, self._vehicle.params
        radius, rate = p["CIRCLE_RADIUS"] / 100, math.radians(p["CIRCLE_RATE"])
        if radius > 0:
            fastest = min(pilot.limits.speed, math.sqrt(radius * pilot.limits.acceleration))
            rate = math.copysign(min(abs(rate), fastest / radius), rate)
        self._angle += rate * dt
        s, c = math.sin(self._angle), math.cos(self._angle)
        pilot.place = (self._centre[0] + radius * c, self._centre[1] + radius * s)
        pilot.velocity = (-radius * rate * s, radius * rate * c)
        pilot.yaw = self._angle + math.pi

    def _follow(self) -> None:
        """Stay beside the target; one that is lost or too far away stops the copter where it is."""
        vehicle, pilot, body = self._vehicle, self._vehicle.pilot, self._vehicle.body
        found = vehicle.leader.estimate(vehicle.wall)
        if found is None:
            self._stop()
            return
        estimate, age = found
        vn, ve, vd = estimate.velocity
        north, east = vehicle.place_of(estimate.lat, estimate.lon)
        n, e, d = north + vn * age, east + ve * age, vd * age - estimate.altitude
        away = math.dist((n, e, d), (body.n, body.e, body.d))
        if away > vehicle.params["FOLL_DIST_MAX"] > 0:
            self._stop()
            return
        dn, de, dd = vehicle.leader.offset((body.n - n, body.e - e, body.d - d))
        pilot.place, pilot.depth = (n + dn, e + de), d + dd
        pilot.velocity, pilot.most = (vn, ve), self.follows_at_most
        if (
            vehicle.params["FOLL_YAW_BEHAVE"] == _FACES_IT
            and math.hypot(n - body.n, e - body.e) > 1
        ):
            pilot.yaw = math.atan2(e - body.e, n - body.n)

    @property
    def follows_at_most(self) -> float:
        """The speed that FOLLOW does not exceed, m/s."""
        return self._vehicle.pilot.limits.speed

    def _stop(self) -> None:
        pilot = self._vehicle.pilot
        pilot.place, pilot.velocity = None, (0.0, 0.0)
        pilot.depth, pilot.sinking = None, 0.0

    def _by_stick(self, mode: Mode) -> None:
        vehicle = self._vehicle
        pilot, body, sticks = vehicle.pilot, vehicle.body, vehicle.sticks
        level = mode in (Mode.STABILIZE, Mode.ALT_HOLD)
        if not sticks.held:
            if self._steered:
                self._steered = False
                pilot.hold()
            if level:  # with centred sticks it drifts with the wind
                pilot.place, pilot.velocity = None, (body.wind_n, body.wind_e)
            return
        self._steered = True
        if body.landed and sticks.throttle > 0:
            pilot.spinning = True
        p, most = vehicle.params, math.radians(vehicle.params["ANGLE_MAX"] / 100)
        pilot.yaw_rate = sticks.yaw * math.radians(p["PILOT_Y_RATE"])
        lean = (sticks.roll * most, sticks.pitch * most)
        if mode is Mode.STABILIZE:
            pilot.attitude = (*lean, max(0.0, 0.5 + sticks.throttle / 2))
            return
        down = p["PILOT_SPEED_DN"] or p["PILOT_SPEED_UP"]
        rate = p["PILOT_SPEED_UP"] if sticks.throttle > 0 else down
        if sticks.throttle:
            pilot.depth, pilot.sinking = None, -sticks.throttle * rate / 100
        elif pilot.depth is None:
            pilot.depth = body.d
        if level:
            pilot.lean = lean
        else:
            self._push(p["LOIT_SPEED"] / 100)

    def _push(self, fastest: float) -> None:
        pilot, body, sticks = self._vehicle.pilot, self._vehicle.body, self._vehicle.sticks
        forward, right = -sticks.pitch * fastest, sticks.roll * fastest
        if forward or right:
            s, c = math.sin(body.yaw), math.cos(body.yaw)
            pilot.place = None
            pilot.velocity = (forward * c - right * s, forward * s + right * c)
        elif pilot.place is None:
            depth, sinking, turning = pilot.depth, pilot.sinking, pilot.yaw_rate
            pilot.hold()
            pilot.depth, pilot.sinking, pilot.yaw_rate = depth, sinking, turning

    def go_home(self) -> None:
        """Climb, then go home or to a nearer rally point."""
        vehicle = self._vehicle
        pilot, body, home = vehicle.pilot, vehicle.body, vehicle.haven()
        height = -body.d
        away = math.hypot(body.n - home[0], body.e - home[1])
        wanted = vehicle.params["RTL_ALT"] / 100
        cone = max(_HIGHEST_WITHOUT_CLIMB, away * vehicle.params["RTL_CONE_SLOPE"])
        pilot.depth = -max(height, min(wanted, cone))
        self.phase = "climb"
        if vehicle.params["RTL_SPEED"] > 0:
            pilot.limits.speed = vehicle.params["RTL_SPEED"] / 100

    def _return(self, dt: float) -> None:
        pilot, vehicle = self._vehicle.pilot, self._vehicle
        if self.phase == "climb":
            if abs(vehicle.body.d - (pilot.depth or 0.0)) < 0.5:
                self.phase = "return"
                pilot.place = vehicle.haven()
                pilot.yaw = self._bearing(pilot.place)
        elif self.phase == "return":
            if pilot.at_place(1.0):
                self.phase, self._waited = "loiter", 0.0
        elif self.phase == "loiter":
            self._waited += dt
            if self._waited >= vehicle.params["RTL_LOIT_TIME"] / 1000:
                self.phase = "land"
        else:
            self.descend()

    def _bearing(self, place: tuple[float, float]) -> float:
        vehicle = self._vehicle
        dn, de = place[0] - vehicle.body.n, place[1] - vehicle.body.e
        return math.atan2(de, dn) if math.hypot(dn, de) > 2 else vehicle.pilot.yaw

    def descend(self) -> None:
        """Descend in place, more slowly near the ground."""
        vehicle = self._vehicle
        p, pilot, body = vehicle.params, vehicle.pilot, vehicle.body
        pilot.depth = None
        low = -body.d < p["LAND_ALT_LOW"] / 100
        fast = p["LAND_SPEED_HIGH"] or p["WPNAV_SPEED_DN"]
        pilot.sinking = (p["LAND_SPEED"] if low else fast) / 100
        if not vehicle.position_ok:  # level, because it has no position
            pilot.place, pilot.velocity = None, (body.wind_n, body.wind_e)

    def begin_landing(self, place: tuple[float, float]) -> None:
        """Go over the position at the present height."""
        pilot = self._vehicle.pilot
        pilot.place, pilot.depth = place, self._vehicle.body.d

    def begin_return(self) -> None:
        """Go home, as a mission item."""
        vehicle = self._vehicle
        height = max(-vehicle.body.d, vehicle.params["RTL_ALT"] / 100)
        vehicle.pilot.place, vehicle.pilot.depth = vehicle.haven(), -height

    def come_down(self) -> bool:
        """Continue the landing of a mission; return whether it is complete."""
        mission = self.mission
        if not mission.landing and self._vehicle.pilot.at_place(1.0):
            mission.landing = True
        if mission.landing:
            self.descend()
        return mission.landing and self._vehicle.body.landed

    @property
    def landing(self) -> bool:
        """Whether it is landing."""
        return (
            self.mode is Mode.LAND
            or (self.mode is Mode.RTL and self.phase == "land")
            or (self.mode is Mode.AUTO and self.mission.landing)
        )

    def rest(self) -> None:
        """Stop the motors after a landing, or if it does not take off in time."""
        vehicle = self._vehicle
        if not vehicle.body.landed:
            return
        if self.landing and self.landed_for >= _ON_THE_FLOOR:
            self.disarm()
            return
        rising = vehicle.sticks.held and vehicle.sticks.throttle > 0
        if self.taking_off or rising or self.mode in (Mode.RTL, Mode.LAND):
            return
        vehicle.pilot.spinning = False
        delay = vehicle.params["DISARM_DELAY"]
        if delay and min(self.landed_for, vehicle.armed_for) >= delay:
            self.disarm()
