"""What each mode makes the pilot do, as far as it is the same for every kind of vehicle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal

from rcp_mavlink_sim.mission import Mission
from rcp_mavlink_sim.modes import Mode, needs_position
from rcp_mavlink_sim.state import VehicleState

__all__ = ["FORCE", "Flight", "Submode"]

FORCE = (21196.0, 2989.0)
"""Of the second parameter of COMPONENT_ARM_DISARM: whatever speaks against it."""

Submode = Literal["", "takeoff", "place", "velocity", "attitude"]


class Flight(ABC):
    """The mode in force and how far it has come."""

    radius = 1.0
    """Within which a waypoint is reached, m."""
    starts_itself = False
    """Whether a mission begins in AUTO as soon as it is armed."""
    patience = 3.0
    """Real seconds that a set-point stands."""
    paced = frozenset({Mode.GUIDED, Mode.AUTO})
    """Modes in which DO_CHANGE_SPEED is heeded; it fails in others."""

    def __init__(self, vehicle: VehicleState) -> None:
        self._vehicle = vehicle
        self.mode = vehicle.kind.first
        self.mission = Mission(vehicle, self)
        self.landed_for = 0.0
        """Simulated seconds on the floor."""
        self.taking_off = False
        self.phase = ""
        """Of RTL and LAND."""
        self.submode: Submode = ""
        """What it does in GUIDED; a change of it has a copter forget the speed it was told."""
        self._speeds: dict[str, float] = {}
        """What DO_CHANGE_SPEED asked for, by the name of the limit."""
        self._setpoint_ends: float | None = None

    def set_mode(self, mode: Mode) -> bool:
        """Change the mode; tell whether it could be."""
        if mode is self.mode:
            return True
        if (reason := self.refusal(mode)) is not None:
            self._vehicle.send_text(4, reason)
            return False
        self.enter(mode)
        return True

    def retreat(self, *, return_home: bool, to: Mode | None = None) -> None:
        """Enter the mode of a failsafe, or of a crossed fence."""
        vehicle = self._vehicle
        done = Mode.RTL if return_home and vehicle.position_ok else vehicle.kind.down
        if to is not None and self.refusal(to) is None:
            done = to
        if self.mode is not done:
            self.enter(done)

    def disarm(self, force: float = 0.0) -> bool:
        """Stop the motors; not in the air, unless forced."""
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
        """Take the speeds from the parameters, but for those that a command asked for."""
        self.limits()
        for name, speed in self._speeds.items():
            setattr(self._vehicle.pilot.limits, name, speed)

    def change_speed(self, speed: float, which: str = "speed") -> bool:
        """Take DO_CHANGE_SPEED (`speed`, `up` or `down`, m/s); tell whether that can be now."""
        if self.mode not in self.paced:
            return False
        if self.mode is Mode.GUIDED and not self._paces:
            return False
        self._speeds[which] = speed
        self.tune()
        return True

    @property
    def _paces(self) -> bool:
        """What drives has a speed in GUIDED only on its way to a place."""
        return self._vehicle.kind.flies or self.submode == "place"

    def aim(self, place: tuple[float, float] | None, depth: float | None) -> None:
        """Go to a place in GUIDED; it looks where it goes to."""
        pilot = self._vehicle.pilot
        if self.submode != "place":
            self._become("place")
        self._setpoint_ends, self.taking_off = None, False
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
        """Whether it turns to where it goes to, unless it is told otherwise."""
        return False

    def follow(self, submode: Submode) -> None:
        """Let the set-point that the pilot was given stand for a while."""
        if self.submode != submode:
            self._become(submode)
        self._setpoint_ends = self._vehicle.wall + self.patience
        self.taking_off = False

    def _expire(self) -> None:
        """End a set-point that was not repeated: one of attitude leaves it level, and drifting."""
        pilot = self._vehicle.pilot
        self._setpoint_ends = None
        if self.submode == "attitude":
            pilot.attitude, pilot.lean = None, (0.0, 0.0)
            pilot.depth, pilot.sinking = None, 0.0
            pilot.yaw, pilot.yaw_rate = self._vehicle.body.yaw, 0.0
        else:
            pilot.hold()

    def step(self, dt: float) -> None:
        """Lead the pilot for `dt` simulated seconds."""
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
        self.rest()

    def finished(self) -> None:  # noqa: B027 - a copter does nothing
        """Do what is due at the end of a mission."""

    @abstractmethod
    def limits(self) -> None:
        """Take the speeds from the parameters."""

    @abstractmethod
    def lead(self, dt: float) -> None:
        """Lead the pilot for `dt` seconds in any mode but AUTO."""

    @abstractmethod
    def rest(self) -> None:
        """Stop the motors where that is due."""

    @abstractmethod
    def take_off(self, height: float) -> bool:
        """Rise to a height over home, m; tell whether that can be done now."""

    @abstractmethod
    def lift(self, height: float) -> None:
        """Rise from here, as an item of a mission."""

    @abstractmethod
    def risen(self) -> bool:
        """Tell whether it has risen as high as it should."""

    @abstractmethod
    def begin_landing(self, place: tuple[float, float]) -> None:
        """Go to a place in order to land there, as an item of a mission."""

    @abstractmethod
    def come_down(self) -> bool:
        """Go on with the landing of a mission; tell whether it is over."""

    @abstractmethod
    def begin_return(self) -> None:
        """Go home, as an item of a mission; `come_down` goes on with it."""

    @abstractmethod
    def go_home(self) -> None:
        """Begin RTL."""

    @property
    @abstractmethod
    def landing(self) -> bool:
        """Whether it is on its way down to the floor."""
