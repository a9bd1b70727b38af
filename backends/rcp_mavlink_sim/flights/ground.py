"""The modes of a rover or a boat."""

from __future__ import annotations

from rcp_mavlink_sim.flight import Flight
from rcp_mavlink_sim.ground.pilot import GroundPilot
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.state import VehicleState

__all__ = ["GroundFlight"]

_FASTEST, _TURN = 6.0, 1.6  # m/s and rad/s at full stick deflection


class GroundFlight(Flight):
    """The motion of a rover or a boat."""

    starts_itself = True

    def __init__(self, vehicle: VehicleState) -> None:
        super().__init__(vehicle)
        self._home = False
        self._cruise: float | None = None
        """The speed that the parameters had when the mode was entered, m/s."""

    @property
    def _pilot(self) -> GroundPilot:
        pilot = self._vehicle.pilot
        assert isinstance(pilot, GroundPilot)
        return pilot

    def limits(self) -> None:
        """Apply the speeds of the parameters."""
        p, limits = self._vehicle.params, self._pilot.limits
        if self._cruise is None:
            self._cruise = p["WP_SPEED"] or p["CRUISE_SPEED"]
        limits.speed = self._cruise
        limits.acceleration = p["ATC_ACCEL_MAX"]
        self.radius = p["WP_RADIUS"]
        self._pilot.near = p["LOIT_RADIUS"] / 2 if self._vehicle.kind.name == "boat" else 0.3

    def enter(self, mode: Mode) -> None:
        """Enter a mode, which takes its speed from the parameters once."""
        self._cruise = None
        super().enter(mode)

    def lead(self, dt: float) -> None:
        """Control the pilot for `dt` seconds in any mode except AUTO."""
        pilot, vehicle = self._pilot, self._vehicle
        pilot.spinning = True
        match self.mode:
            case Mode.MANUAL | Mode.STEERING:
                sticks = vehicle.sticks
                pilot.by_hand = (sticks.throttle * _FASTEST, sticks.roll * _TURN)
            case Mode.HOLD:
                pilot.by_hand = (0.0, 0.0)
            case Mode.RTL | Mode.SMART_RTL if pilot.at_place(self.radius) and not self._home:
                self._home = True
                vehicle.send_text(6, "Reached destination")
            case _:
                pass

    def rest(self) -> None:
        """Do nothing: it stays armed when it stops."""
        self._vehicle.pilot.spinning = True

    def take_off(self, height: float) -> bool:
        """Do nothing: it cannot take off."""
        return False

    def lift(self, height: float) -> None:
        """Do nothing: it cannot take off."""

    def risen(self) -> bool:
        """Return True: the mission continues."""
        return True

    def begin_landing(self, place: tuple[float, float]) -> None:
        """Go to the position."""
        self._pilot.place = place

    def begin_return(self) -> None:
        """Go home, as a mission item."""
        self.go_home()

    def come_down(self) -> bool:
        """Return whether it has arrived."""
        return self._pilot.at_place(self.radius)

    def go_home(self) -> None:
        """Drive home, or to a nearer rally point."""
        self._home = False
        self._pilot.place = self._vehicle.haven()

    def finished(self) -> None:
        """Hold at the end of a mission."""
        self._vehicle.send_text(5, "Mission Complete")
        self.set_mode(Mode.HOLD)

    @property
    def landing(self) -> bool:
        """False: it never lands."""
        return False
