"""Flight logic common to all kinds of vehicles: what each mode makes the pilot do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal

from rcp_mavlink_sim.mission import Mission
from rcp_mavlink_sim.modes import Mode, needs_position
from rcp_mavlink_sim.state import VehicleState

__all__ = ["FORCE", "Flight", "Submode"]

FORCE = (21196.0, 2989.0)
"""Second parameter of COMPONENT_ARM_DISARM: overrides all checks."""

_GROUNDLESS = 5.0  # s (`FS_TERRAIN_TIMEOUT_MS`)
Submode = Literal["", "takeoff", "place", "velocity", "attitude"]


class Flight(ABC):
    """The present mode and its progress."""

    radius = 1.0
    """Radius within which a waypoint counts as reached, m."""
    starts_itself = False
    """Whether a mission starts in AUTO on arming."""
    patience = 3.0
    """Real seconds until a set-point expires."""
    led = Mode.GUIDED
    """The mode that follows set-points."""
    paced = frozenset({Mode.GUIDED, Mode.AUTO})
    """Modes that obey DO_CHANGE_SPEED; it fails in others."""

    def __init__(self, vehicle: VehicleState) -> None:
        self._vehicle = vehicle
        self.mode = vehicle.kind.first
        self.mission = Mission(vehicle, self)
        self.landed_for = 0.0
        """Simulated seconds on the ground."""
        self.taking_off = False
        self.phase = ""
        """Phase of RTL and LAND."""
        self.submode: Submode = ""
        """What it does in GUIDED; a change makes a copter discard a commanded speed."""
        self._speeds: dict[str, float] = {}
        """Speeds set by DO_CHANGE_SPEED, by the name of the limit."""
        self._setpoint_ends: float | None = None
        self.height_over_ground: float | None = None
        """Height above the ground to keep on the way to a target, m; None: that of the pilot."""
        self._groundless = 0.0

    def set_mode(self, mode: Mode) -> bool:
        """Change the mode; return whether this succeeded."""
        if mode is self.mode:
            return True
        if (reason := self.refusal(mode)) is not None:
            self._vehicle.send_text(4, reason)
            return False
        self.enter(mode)
        return True

    def retreat(self, *, return_home: bool, to: Mode | None = None) -> None:
        """Enter the mode of a failsafe or of a fence action."""
        vehicle = self._vehicle
        done = Mode.RTL if return_home and vehicle.position_ok else vehicle.kind.down
        if to is not None and self.refusal(to) is None:
            done = to
        if self.mode is not done:
            self.enter(done)

    def disarm(self, force: float = 0.0) -> bool:
        """Stop the motors; refused in the air, unless forced."""
        vehicle = self._vehicle
        if not vehicle.armed:
            return True
        if not vehicle.body.landed and force not in FORCE:
            return False
        vehicle.send_text(6, "Disarming motors")
        vehicle.armed = vehicle.pilot.spinning = False
        self.mission.leave()
        self.taking_off = False
        return True

    def refusal(self, mode: Mode) -> str | None:
        """Return why a mode cannot be entered now; None if it can."""
        vehicle = self._vehicle
        if not vehicle.armed:
            return None
        if needs_position(mode) and not vehicle.position_ok:
            return f"Mode change to {mode.name} failed: requires position"
        if mode is Mode.AUTO and not self.mission.flyable:
            return "Mode change to AUTO failed: init failed"
        return None

    def enter(self, mode: Mode) -> None:
        """Enter a mode."""
        vehicle, before = self._vehicle, self.mode
        self.mode = mode
        self.phase, self.taking_off, self._setpoint_ends = "", False, None
        self.height_over_ground = None
        vehicle.pilot.hold()
        self._become("")
        if before is Mode.AUTO and mode is not Mode.AUTO:
            self.mission.leave()
        if mode is Mode.AUTO and vehicle.armed and not vehicle.body.landed:
            self.mission.start()
        if mode in (Mode.RTL, Mode.SMART_RTL):
            self.go_home()

    def _become(self, submode: Submode) -> None:
        self.submode = submode
        if self._vehicle.kind.name == "copter" or not submode:
            self._speeds.clear()
        self.tune()

    def tune(self) -> None:
        """Apply the speeds of the parameters, except those set by a command."""
        self.limits()
        for name, speed in self._speeds.items():
            setattr(self._vehicle.pilot.limits, name, speed)

    def apply_parameters(self) -> None:
        """Apply changed parameters to the present motion, as far as the autopilot does so."""
        self.tune()

    def change_speed(self, speed: float, which: str = "speed") -> bool:
        """Handle DO_CHANGE_SPEED (`speed`, `up` or `down`, m/s); return whether it is accepted."""
        if self.mode not in self.paced:
            return False
        if self.mode is Mode.GUIDED and not self._paces:
            return False
        self._speeds[which] = speed
        self.tune()
        return True

    @property
    def _paces(self) -> bool:
        """Whether a speed is accepted; ground vehicles in GUIDED need a target position."""
        return self._vehicle.kind.flies or self.submode == "place"

    def aim(self, place: tuple[float, float] | None, depth: float | None) -> None:
        """Go to a position in GUIDED, facing the direction of travel."""
        pilot = self._vehicle.pilot
        if self.submode != "place":
            self._become("place")
        self._setpoint_ends, self.taking_off = None, False
        self.height_over_ground = None
        pilot.attitude, pilot.velocity, pilot.sinking = None, (0.0, 0.0), 0.0
        pilot.lean = None
        pilot.yaw_rate = 0.0
        pilot.faces_travel = self.faces_travel
        if place is not None:
            pilot.place = place
        if depth is not None:
            pilot.depth = depth

    @property
    def faces_travel(self) -> bool:
        """Whether it faces the direction of travel by default."""
        return False

    def follow(self, submode: Submode) -> None:
        """Activate the set-point that was given to the pilot, until it expires."""
        if self.submode != submode:
            self._become(submode)
        self._setpoint_ends = self._vehicle.wall + self.patience
        self.height_over_ground = None
        self.taking_off = False

    def _expire(self) -> None:
        """End an expired set-point; an attitude leaves the vehicle level, and drifting."""
        pilot = self._vehicle.pilot
        self._setpoint_ends = None
        if self.submode == "attitude":
            pilot.attitude, pilot.lean = None, (0.0, 0.0)
            pilot.depth, pilot.sinking = None, 0.0
            pilot.yaw, pilot.yaw_rate = self._vehicle.body.yaw, 0.0
        else:
            pilot.hold()

    def step(self, dt: float) -> None:
        """Control the pilot for `dt` simulated seconds."""
        vehicle = self._vehicle
        self.landed_for = self.landed_for + dt if vehicle.body.landed else 0.0
        if not vehicle.armed:
            vehicle.pilot.spinning = False
            return
        if self._setpoint_ends is not None and vehicle.wall > self._setpoint_ends:
            self._expire()
        if self.mode is Mode.AUTO:
            if self.starts_itself and not (self.mission.running or self.mission.complete):
                self.mission.start()
            self.mission.step(dt)
        else:
            self.lead(dt)
        self._follow_ground(dt)
        self.rest()

    def _follow_ground(self, dt: float) -> None:
        """Keep a height above the ground; a copter that does not know it for a while returns."""
        wanted, vehicle = self.height_over_ground, self._vehicle
        height = None if wanted is None else vehicle.above_ground(wanted)
        if height is not None:
            vehicle.pilot.depth = -height
        self._groundless = self._groundless + dt if wanted is not None and height is None else 0.0
        if self._groundless > _GROUNDLESS and vehicle.kind.flies:
            vehicle.send_text(2, "Failsafe: Terrain data missing")
            self.retreat(return_home=True)

    def finished(self) -> None:  # noqa: B027 - a copter does nothing
        """Act at the end of a mission."""

    @abstractmethod
    def limits(self) -> None:
        """Apply the speeds of the parameters."""

    @abstractmethod
    def lead(self, dt: float) -> None:
        """Control the pilot for `dt` seconds in any mode except AUTO."""

    @abstractmethod
    def rest(self) -> None:
        """Stop the motors when due."""

    @abstractmethod
    def take_off(self, height: float) -> bool:
        """Climb to a height above home, m; return whether this is possible now."""

    @abstractmethod
    def lift(self, height: float) -> None:
        """Take off from here, as a mission item."""

    @abstractmethod
    def risen(self) -> bool:
        """Return whether the take-off has reached its height."""

    @abstractmethod
    def begin_landing(self, place: tuple[float, float]) -> None:
        """Go to a position and land there, as a mission item."""

    @abstractmethod
    def come_down(self) -> bool:
        """Continue the landing of a mission; return whether it is complete."""

    @abstractmethod
    def begin_return(self) -> None:
        """Go home, as a mission item; `come_down` continues it."""

    @abstractmethod
    def go_home(self) -> None:
        """Start RTL."""

    @property
    @abstractmethod
    def landing(self) -> bool:
        """Whether it is landing."""
