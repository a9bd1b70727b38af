"""The systems of a vehicle: flight, fence, failsafes, camera, files and logs."""

from __future__ import annotations

from rcp_mavlink_sim.arming import complaints
from rcp_mavlink_sim.calibrations import Calibrations
from rcp_mavlink_sim.camera import Camera
from rcp_mavlink_sim.failsafes import Failsafes
from rcp_mavlink_sim.fence import Fence
from rcp_mavlink_sim.files import Files
from rcp_mavlink_sim.flight import Flight
from rcp_mavlink_sim.flightlog import FlightLog
from rcp_mavlink_sim.flights.copter import CopterFlight
from rcp_mavlink_sim.flights.ground import GroundFlight
from rcp_mavlink_sim.flights.plane import PlaneFlight
from rcp_mavlink_sim.modes import needs_position
from rcp_mavlink_sim.motor_test import MotorTest
from rcp_mavlink_sim.mount import Mount
from rcp_mavlink_sim.options import Options
from rcp_mavlink_sim.payloads import Payloads
from rcp_mavlink_sim.state import VehicleState

__all__ = ["Systems"]

_FLIGHTS: dict[str, type[Flight]] = {
    "copter": CopterFlight,
    "plane": PlaneFlight,
    "rover": GroundFlight,
    "boat": GroundFlight,
}


class Systems(VehicleState):
    """A vehicle with its systems, as telemetry and commands need it."""

    def __init__(self, options: Options) -> None:
        self.log = FlightLog()
        super().__init__(options)
        self.files = Files(options.vehicle, self.params, self.log, self.make_metadata())
        self.camera = Camera(self, self.files)

    def begin(self, heading: float) -> None:
        """Start at the origin with the motors off, as after power-on."""
        super().begin(heading)
        self.flight = self.make_flight()
        self.flight.limits()
        self.failsafes = self.make_failsafes()
        self.fence = self.make_fence()
        self.mount, second = Mount(self), Mount(self, 2)
        self.mounts = (self.mount, second)
        """Those of `MNT1_*` and `MNT2_*`; the first is the primary one, with the camera."""
        self.payloads = Payloads(self)
        self.motor_test = MotorTest(self)
        self.calibrations = self.make_calibrations()

    def make_flight(self) -> Flight:
        """Return its flight logic."""
        return _FLIGHTS[self.kind.name](self)

    def make_metadata(self) -> dict[str, bytes]:
        """Return the files in which it tells of itself: an ArduPilot has none."""
        return {}

    def make_fence(self) -> Fence:
        """Return its fence."""
        return Fence(self, self.flight)

    def make_calibrations(self) -> Calibrations:
        """Return its calibrations."""
        return Calibrations(self)

    def make_failsafes(self) -> Failsafes:
        """Return its failsafes."""
        return Failsafes(self, self.flight)

    def complaints(self) -> list[str]:
        """List what prevents arming, in ArduPilot's words; empty if it may arm."""
        return complaints(self, self.flight, self.failsafes, self.fence, self.calibrations)

    def gimbal(self, device: float) -> Mount | None:
        """Return the mount of a gimbal device id; 0 is the primary one, None if it is not fitted."""
        number = device or 1
        return next(
            (mount for mount in self.mounts if mount.fitted and mount.number == number), None
        )

    @property
    def ready(self) -> bool:
        """The pre-arm bit; as in ArduPilot, it is set too early in a mode without a position."""
        if self.complaints():
            return False
        return not needs_position(self.flight.mode) or self.position_ok
