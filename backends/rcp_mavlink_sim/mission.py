"""Running a stored mission: one item after the other, as in AUTO."""

from __future__ import annotations

import math
from typing import Protocol

from rcp_mavlink_sim.plans import Item, Plan
from rcp_mavlink_sim.state import VehicleState
from rcp_mavlink_sim.wire import mav

__all__ = ["Manoeuvres", "Mission"]

_NAMES = {16: "WP", 17: "LoitUnlim", 18: "LoitTurns", 19: "LoitTime", 20: "RTL", 21: "Land", 22: "Takeoff", 82: "Spline", 93: "Delay", 112: "Delay", 115: "Yaw", 177: "Jump", 178: "ChangeSpeed", 179: "SetHome"}  # fmt: skip
_LAST_MOVE = mav.MAV_CMD_NAV_LAST
_TRAVELS = frozenset({16, 17, 18, 19, 82})


class Manoeuvres(Protocol):
    """The manoeuvres that a mission needs."""

    radius: float
    """Radius within which a waypoint counts as reached, m."""
    height_over_ground: float | None
    """Height above the ground to keep on the way, m; None: that of the pilot."""

    def lift(self, height: float) -> None:
        """Take off from here."""

    def risen(self) -> bool:
        """Return whether the take-off has reached its height."""
        ...

    def begin_landing(self, place: tuple[float, float]) -> None:
        """Go to a position and land there."""

    def begin_return(self) -> None:
        """Go home; `come_down` continues it."""

    def come_down(self) -> bool:
        """Continue the landing; return whether it is complete."""
        ...

    def change_speed(self, speed: float) -> bool:
        """Handle DO_CHANGE_SPEED, m/s; return whether it is accepted."""
        ...

    def finished(self) -> None:
        """Act at the end of the mission."""


class Mission:
    """The stored mission and its current item."""

    def __init__(self, vehicle: VehicleState, flight: Manoeuvres) -> None:
        self._vehicle, self._flight = vehicle, flight
        self.plan = Plan(mav.MAV_MISSION_TYPE_MISSION)
        self.current = 0
        self.running = self.complete = self.paused = False
        self.landing = False
        self.reached = 0
        """The last item reached; 0 if none."""
        self._began = False
        self._waited = 0.0
        self._jumps: dict[int, int] = {}

    @property
    def flyable(self) -> bool:
        """Whether there are items besides home."""
        return len(self.plan.items) > 1

    @property
    def takes_off(self) -> bool:
        """Whether its first movement is a take-off."""
        moves = [item.command for item in self.plan.items[1:] if item.command < _LAST_MOVE]
        return moves[:1] == [mav.MAV_CMD_NAV_TAKEOFF]

    def start(self) -> None:
        """Start or resume it."""
        if not self.flyable:
            return
        over = self.complete or not 1 <= self.current < len(self.plan.items)
        if over or self._vehicle.params["MIS_RESTART"]:
            self.current, self._jumps = 1, {}
        self.running, self.complete, self._began = True, False, False
        self.paused = self.landing = False

    def leave(self) -> None:
        """Suspend it."""
        self.running = self._began = self.landing = False

    def changed(self) -> None:
        """Restart after an upload."""
        self.current, self.complete, self._began = 0, False, False
        self.reached = 0
        if self.running:
            self.running = False
            self._vehicle.pilot.hold()

    def go_to(self, number: int) -> bool:
        """Set the current item; return whether it exists."""
        if not 0 <= number < max(1, len(self.plan.items)):
            return False
        self.current, self._began, self.complete = number, False, False
        self.landing = False
        return True

    def pause(self, *, paused: bool) -> None:
        """Pause or resume."""
        self.paused = paused
        if paused:
            self._vehicle.pilot.hold()
        self._began = False

    def step(self, dt: float) -> None:
        """Continue for `dt` simulated seconds."""
        if not self.running or self.paused:
            return
        if self.current == 0:
            self.current = 1
        item = self.plan.items[self.current]
        if not self._began:
            self._began, self._waited = True, 0.0
            self._say(f"Mission: {self.current} {_NAMES.get(item.command, 'Cmd')}")
            self._begin(item)
        if self._done(item, dt):
            self._next(item)

    def _next(self, item: Item) -> None:
        if item.command in _TRAVELS or item.command in (21, 22):
            self.reached = self.current
            self._say(f"Reached command #{self.current}")
            number = self.current if self._vehicle.kind.counts_home else self.current - 1
            self._vehicle.broadcast(mav.MAVLink_mission_item_reached_message(number))
        self._began = False
        if item.command == mav.MAV_CMD_DO_JUMP and self._jump(item):
            return
        self.current += 1
        if self.current >= len(self.plan.items):
            self.current = len(self.plan.items) - 1
            self.running, self.complete = False, True
            self._vehicle.pilot.hold()
            self._flight.finished()

    def _say(self, text: str) -> None:
        """Send what ArduPilot says of its missions."""
        if self._vehicle.kind.counts_home:
            self._vehicle.send_text(6, text)

    def _jump(self, item: Item) -> bool:
        done = self._jumps.get(self.current, 0)
        target, times = int(item.params[0]), int(item.params[1])
        if not 0 < target < len(self.plan.items) or 0 <= times <= done:
            return False
        self._jumps[self.current] = done + 1
        self.current = target
        return True

    def _begin(self, item: Item) -> None:
        vehicle = self._vehicle
        if item.command < _LAST_MOVE:
            self._flight.height_over_ground = None
        pilot = vehicle.pilot
        match item.command:
            case mav.MAV_CMD_NAV_TAKEOFF:
                self._flight.lift(item.alt)
            case mav.MAV_CMD_NAV_LAND:
                self._flight.begin_landing(self._place(item))
            case mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                self._flight.begin_return()
            case mav.MAV_CMD_DO_CHANGE_SPEED if item.params[1] > 0:
                self._flight.change_speed(item.params[1])
            case mav.MAV_CMD_CONDITION_YAW:
                pilot.yaw = math.radians(item.params[0])
            case mav.MAV_CMD_DO_SET_HOME:
                here = item.params[0] == 1
                vehicle.set_home(None if here else (item.lat, item.lon, item.alt))
            case command if command in _TRAVELS:
                self._travel(item)
            case _:
                pass

    def _travel(self, item: Item) -> None:
        pilot, body = self._vehicle.pilot, self._vehicle.body
        place = self._place(item)
        distance = math.dist(place, (body.n, body.e))
        if distance > 2:
            pilot.yaw = math.atan2(place[1] - body.e, place[0] - body.n)
        pilot.place, pilot.depth, pilot.attitude = place, self._depth(item), None
        over_ground = item.frame == mav.MAV_FRAME_GLOBAL_TERRAIN_ALT
        self._flight.height_over_ground = item.alt if over_ground else None
        pilot.passes = item.command in (16, 82)
        pilot.spinning = pilot.spinning or not body.landed or not self._vehicle.kind.flies

    def _place(self, item: Item) -> tuple[float, float]:
        if item.lat == 0 and item.lon == 0:
            return self._vehicle.body.n, self._vehicle.body.e
        return self._vehicle.place_of(item.lat, item.lon)

    def _depth(self, item: Item) -> float:
        height = item.alt
        if item.frame in (0, 5):
            height -= self._vehicle.origin[2]
        elif item.frame == mav.MAV_FRAME_GLOBAL_TERRAIN_ALT:
            above_home = self._vehicle.above_ground(height, self._place(item))
            return self._vehicle.body.d if above_home is None else -above_home
        return -height

    def _done(self, item: Item, dt: float) -> bool:
        match item.command:
            case mav.MAV_CMD_NAV_TAKEOFF:
                return self._flight.risen()
            case mav.MAV_CMD_NAV_LAND | mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                return self._flight.come_down()
            case mav.MAV_CMD_NAV_LOITER_UNLIM:
                return False
            case mav.MAV_CMD_NAV_WAYPOINT | mav.MAV_CMD_NAV_SPLINE_WAYPOINT:
                return self._stayed(item.params[0], dt)
            case mav.MAV_CMD_NAV_LOITER_TIME | mav.MAV_CMD_NAV_LOITER_TURNS:
                return self._stayed(item.params[0], dt)
            case mav.MAV_CMD_NAV_DELAY | mav.MAV_CMD_CONDITION_DELAY:
                self._waited += dt
                return self._waited >= item.params[0]
            case _:
                return True

    def _stayed(self, seconds: float, dt: float) -> bool:
        if self._waited or self._vehicle.pilot.at_place(self._flight.radius):
            self._waited += dt
        return self._waited > max(0.0, seconds)
