"""Flight logs: lines of text, downloaded like the logs of a real vehicle."""

from __future__ import annotations

from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.state import VehicleState

__all__ = ["FlightLog"]

_PERIOD = 0.1  # s
_KEPT = 8
_SIZE = 1_000_000  # bytes, limit of one log


class FlightLog:
    """The last flights, one line per 0.1 simulated seconds while armed."""

    def __init__(self) -> None:
        self.logs: dict[int, bytearray] = {}
        self._number = 0
        self._since = 0.0

    def begin(self, time: float) -> None:
        """Start the log of a new flight."""
        self._number += 1
        self.logs[self._number] = bytearray(b"time,mode,n,e,d,roll,pitch,yaw,volt\n")
        while len(self.logs) > _KEPT:
            del self.logs[min(self.logs)]
        self._since = _PERIOD

    def step(self, vehicle: VehicleState, mode: Mode, dt: float) -> None:
        """Write a line, if due."""
        if not vehicle.armed:
            return
        self._since += dt
        log = self.logs[self._number]
        if self._since < _PERIOD or len(log) > _SIZE:
            return
        self._since = 0.0
        b = vehicle.body
        log += (
            f"{vehicle.time:.2f},{mode.name},{b.n:.2f},{b.e:.2f},{b.d:.2f},"
            f"{b.roll:.3f},{b.pitch:.3f},{b.yaw:.3f},{vehicle.battery.voltage:.2f}\n"
        ).encode()
