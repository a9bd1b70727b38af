"""What each mode makes the pilot do: take off, go, hold, return, land, follow set-points."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rcp_mavlink.sim.mission import Mission
from rcp_mavlink.sim.modes import Mode, needs_position

if TYPE_CHECKING:
    from rcp_mavlink.sim.vehicle import Vehicle

__all__ = ["Flight"]

_ON_THE_FLOOR = 1.0  # s, until it believes that it has landed
_HIGHEST_WITHOUT_CLIMB = 2.0  # m


class Flight:
    """The mode in force and how far it has come."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.mode = Mode.STABILIZE
        self.mission = Mission(vehicle)
        self.landed_for = 0.0
        """Simulated seconds on the floor."""
        self.taking_off = False
        self.phase = ""
        """Of RTL and LAND."""
        self._setpoint_ends: float | None = None
        self._waited = 0.0

    def refusal(self, mode: Mode) -> str | None:
        """Say why a mode cannot be entered now; None: it can."""
        vehicle = self._vehicle
        if not vehicle.armed:
            return None
        if needs_position(mode) and not vehicle.position_ok:
            return f"Mode change to {mode.name} failed: requires position"
        if mode is Mode.AUTO and not self.mission.flyable:
            return "Mode change to AUTO failed: init failed"
        return None

    def enter(self, mode: Mode) -> None:
        """Change the mode."""
        vehicle, before = self._vehicle, self.mode
        self.mode = mode
        self.phase, self.taking_off, self._setpoint_ends = "", False, None
        vehicle.pilot.hold()
        self.limits()
        if before is Mode.AUTO and mode is not Mode.AUTO:
            self.mission.leave()
        if mode is Mode.AUTO and vehicle.armed and not vehicle.body.landed:
            self.mission.start()
        if mode is Mode.RTL:
            self._climb_home()

    def limits(self) -> None:
        """Take the speeds from the parameters."""
        p, limits = self._vehicle.params, self._vehicle.pilot.limits
        limits.speed = p["WPNAV_SPEED"] / 100
        limits.up, limits.down = p["WPNAV_SPEED_UP"] / 100, p["WPNAV_SPEED_DN"] / 100
        limits.acceleration = p["WPNAV_ACCEL"] / 100
        limits.climb_acceleration = p["WPNAV_ACCEL_Z"] / 100 * 1.5

    def take_off(self, height: float) -> bool:
        """Rise to a height over home, m; tell whether that can be done now."""
        vehicle = self._vehicle
        if (
            not vehicle.armed
            or not vehicle.body.landed
            or self.mode not in (Mode.GUIDED, Mode.AUTO)
        ):
            return False
        self.lift(height)
        return True

    def lift(self, height: float) -> None:
        """Rise from here, straight up."""
        pilot, body = self._vehicle.pilot, self._vehicle.body
        pilot.reset()
        pilot.place, pilot.velocity = (body.n, body.e), (0.0, 0.0)
        pilot.depth = -height
        pilot.spinning = self.taking_off = True

    def aim(
        self, place: tuple[float, float] | None, depth: float | None, *, yaw: float | None = None
    ) -> None:
        """Go to a place in GUIDED."""
        pilot = self._vehicle.pilot
        self._setpoint_ends, self.taking_off = None, False
        pilot.attitude, pilot.velocity, pilot.sinking = None, (0.0, 0.0), 0.0
        if place is not None:
            pilot.place = place
        if depth is not None:
            pilot.depth = depth
        if yaw is not None:
            pilot.yaw, pilot.yaw_rate = yaw, 0.0

    def follow(self, seconds: float) -> None:
        """Let the set-point that the pilot was given stand for so many real seconds."""
        self._setpoint_ends = self._vehicle.wall + seconds
        self.taking_off = False

    def step(self, dt: float) -> None:
        """Lead the pilot for `dt` simulated seconds."""
        vehicle = self._vehicle
        self.landed_for = self.landed_for + dt if vehicle.body.landed else 0.0
        if not vehicle.armed:
            vehicle.pilot.spinning = False
            return
        match self.mode:
            case Mode.GUIDED:
                self._guided()
            case Mode.AUTO:
                self.mission.step(dt)
            case Mode.RTL:
                self._return(dt)
            case Mode.LAND:
                self.descend()
            case Mode.STABILIZE | Mode.ALT_HOLD:
                self._drift()
            case _:
                pass
        self._rest(dt)

    def _guided(self) -> None:
        pilot = self._vehicle.pilot
        if self.taking_off and pilot.at_place(0.3):
            self.taking_off = False
        if self._setpoint_ends is not None and self._vehicle.wall > self._setpoint_ends:
            self._setpoint_ends = None
            pilot.hold()

    def _drift(self) -> None:
        """Fly level with the sticks centred: the wind takes it along."""
        pilot, body = self._vehicle.pilot, self._vehicle.body
        pilot.place, pilot.velocity = None, (body.wind_n, body.wind_e)

    def _climb_home(self) -> None:
        vehicle = self._vehicle
        pilot, body, home = vehicle.pilot, vehicle.body, vehicle.home_place()
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
                pilot.place = vehicle.home_place()
                pilot.yaw = self._bearing_home()
        elif self.phase == "return":
            if pilot.at_place(1.0):
                self.phase, self._waited = "loiter", 0.0
        elif self.phase == "loiter":
            self._waited += dt
            if self._waited >= vehicle.params["RTL_LOIT_TIME"] / 1000:
                self.phase = "land"
        else:
            self.descend()

    def _bearing_home(self) -> float:
        vehicle = self._vehicle
        n, e = vehicle.home_place()
        dn, de = n - vehicle.body.n, e - vehicle.body.e
        return math.atan2(de, dn) if math.hypot(dn, de) > 2 else vehicle.pilot.yaw

    def descend(self) -> None:
        """Sink where it is, slower near the floor."""
        p, pilot = self._vehicle.params, self._vehicle.pilot
        pilot.depth = None
        low = -self._vehicle.body.d < p["LAND_ALT_LOW"] / 100
        fast = p["LAND_SPEED_HIGH"] or p["WPNAV_SPEED_DN"]
        pilot.sinking = (p["LAND_SPEED"] if low else fast) / 100

    @property
    def landing(self) -> bool:
        """Whether it is on its way down to the floor."""
        return (
            self.mode is Mode.LAND
            or (self.mode is Mode.RTL and self.phase == "land")
            or (self.mode is Mode.AUTO and self.mission.landing)
        )

    def _rest(self, dt: float) -> None:
        """Stop the motors after a landing, or where nobody takes off."""
        vehicle = self._vehicle
        if not vehicle.body.landed:
            return
        if self.landing and self.landed_for >= _ON_THE_FLOOR:
            vehicle.disarm()
            return
        if self.taking_off:
            return
        if self.mode in (Mode.RTL, Mode.LAND):
            return
        vehicle.pilot.spinning = False
        delay = vehicle.params["DISARM_DELAY"]
        if delay and min(self.landed_for, vehicle.armed_for) >= delay:
            vehicle.disarm()
