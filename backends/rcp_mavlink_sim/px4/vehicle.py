"""The whole copter with PX4."""

from __future__ import annotations

from typing import Any, ClassVar

from rcp_mavlink_sim.failsafes import Failsafes
from rcp_mavlink_sim.fence import Fence
from rcp_mavlink_sim.flight import FORCE, Flight
from rcp_mavlink_sim.follow import Leader
from rcp_mavlink_sim.modes import Mode, needs_position
from rcp_mavlink_sim.options import Options
from rcp_mavlink_sim.parameters import Parameters
from rcp_mavlink_sim.px4.calibrations import Px4Calibrations
from rcp_mavlink_sim.px4.failsafes import Px4Failsafes
from rcp_mavlink_sim.px4.fence import Px4Fence
from rcp_mavlink_sim.px4.flight import Px4Flight
from rcp_mavlink_sim.px4.follow import Px4Leader
from rcp_mavlink_sim.px4.metadata import metadata_files
from rcp_mavlink_sim.px4.parameters import Px4Parameters
from rcp_mavlink_sim.px4.telemetry import MAKERS, USUAL
from rcp_mavlink_sim.vehicle import Vehicle

__all__ = ["Px4Vehicle"]

_NOT_ARMABLE = frozenset({Mode.RTL, Mode.LAND, Mode.CIRCLE, Mode.FOLLOW})


class Px4Vehicle(Vehicle):
    """One simulated copter with PX4."""

    makers: ClassVar[dict[int, Any]] = MAKERS
    usual: ClassVar[dict[int, float]] = USUAL
    boot_texts: ClassVar[tuple[tuple[float, str], ...]] = ()
    ready_text: ClassVar[str] = "Ready for takeoff!"
    calibrations: Px4Calibrations

    def make_parameters(self, options: Options) -> Parameters:
        """Return its parameters."""
        return Px4Parameters(options.parameters)

    def make_leader(self) -> Leader:
        """Return what it follows."""
        return Px4Leader(self.params)

    def make_flight(self) -> Flight:
        """Return its flight logic."""
        return Px4Flight(self)

    def make_metadata(self) -> dict[str, bytes]:
        """Return the files in which it tells of itself."""
        return metadata_files()

    def make_fence(self) -> Fence:
        """Return its fence."""
        return Px4Fence(self, self.flight)

    def make_calibrations(self) -> Px4Calibrations:
        """Return its calibrations."""
        return Px4Calibrations(self)

    def make_failsafes(self) -> Failsafes:
        """Return its failsafes."""
        return Px4Failsafes(self, self.flight)

    def complaints(self) -> list[str]:
        """List what prevents arming, in PX4's words; empty if it may arm."""
        found: list[str] = []
        warm = self.time / self.options.warmup if self.options.warmup > 0 else 1.0
        if warm < 0.2:
            found.append("Attitude failure (roll)")
        elif not self.position_ok and needs_position(self.flight.mode):
            found.append("ekf2 missing data" if warm < 0.5 else "GPS fix too low")
        if self.failsafes.battery_critical:
            found.append("Battery unhealthy")
        if self.fence.breached:
            found.append("Vehicle outside geofence")
        return found

    def arm(self, force: float = 0.0) -> bool:
        """Start the motors; return whether this succeeded."""
        if self.armed:
            return True
        if self.calibrations.what is not None or self.calibrations.radio:
            self.send_text(2, "Arming denied: calibrating")
            return False
        if force not in FORCE and (reasons := self.complaints()):
            for reason in reasons:
                self.send_text(2, f"Preflight Fail: {reason}")
            self.send_text(2, "Arming denied: Resolve system health failures first")
            return False
        if self.flight.mode in _NOT_ARMABLE:
            self.send_text(2, "Arming denied: Mode not suitable for takeoff")
            return False
        self.begin_armed("Armed by external command")
        return True

    def step_checks(self) -> None:
        """Send no reasons by itself: PX4 tells them when it is asked to arm."""

    def step_sticks(self, seconds: float) -> None:
        """Leave the motors to commands: it has no transmitter."""
