"""PX4's failsafes: the link with the ground station, the battery, and the position."""

from __future__ import annotations

from rcp_mavlink_sim.failsafes import Failsafes
from rcp_mavlink_sim.flight import Flight
from rcp_mavlink_sim.modes import Mode, needs_position
from rcp_mavlink_sim.px4.flight import HOLD
from rcp_mavlink_sim.state import VehicleState

__all__ = ["Px4Failsafes"]

_ACTIONS = {1: HOLD, 2: Mode.RTL, 3: Mode.LAND}
"""By NAV_DLL_ACT; 0 does nothing."""
_BLIND = 1.0  # s without a position
_ON_LOW = {1: Mode.RTL, 2: Mode.LAND, 3: Mode.RTL}  # COM_LOW_BAT_ACT


class Px4Failsafes(Failsafes):
    """The active failsafes and their actions; any ground station counts."""

    def __init__(self, vehicle: VehicleState, flight: Flight) -> None:
        super().__init__(vehicle, flight)
        self._position_gone = 0.0

    def check(self, seconds: float) -> None:
        """Check all failsafes; `seconds` of simulated time have passed."""
        self._link()
        self._charge()
        self._place(seconds)

    def on_station_heartbeat(self) -> None:
        """Handle a heartbeat of a ground station."""
        lost, self.station_lost = self.station_lost, False
        self._last_heartbeat, self._station_seen = self._vehicle.wall, True
        if lost:
            self._vehicle.send_text(6, "Connection to ground control station regained")

    def _link(self) -> None:
        vehicle, p = self._vehicle, self._vehicle.params
        late = vehicle.wall - self._last_heartbeat > p["COM_DL_LOSS_T"]
        if self.station_lost or not (self._station_seen and late):
            return
        self.station_lost = True
        vehicle.send_text(4, "Connection to ground control station lost")
        self._act(_ACTIONS.get(int(p["NAV_DLL_ACT"])))

    def _charge(self) -> None:
        vehicle, p = self._vehicle, self._vehicle.params
        if not self.battery_low and vehicle.battery.charge < p["BAT_LOW_THR"]:
            self.battery_low = True
            vehicle.send_text(4, "Low battery level, return advised")
        if not self.battery_critical and vehicle.battery.charge < p["BAT_CRIT_THR"]:
            self.battery_critical = True
            vehicle.send_text(2, "Critical battery level, land now")
            self._act(_ON_LOW.get(int(p["COM_LOW_BAT_ACT"])))

    def _place(self, seconds: float) -> None:
        vehicle = self._vehicle
        gone = vehicle.home is not None and not vehicle.position_ok
        self._position_gone = self._position_gone + seconds if gone else 0.0
        self.blind = self.blind and gone
        if not self.blind and self._position_gone > _BLIND:
            self.blind = True
            if needs_position(self._flight.mode):
                vehicle.send_text(2, "Failsafe activated: No position estimate")
                self._act(Mode.LAND)

    def _act(self, to: Mode | None) -> None:
        if to is None or not self._vehicle.armed or self._vehicle.body.landed:
            return
        if self._flight.mode not in (to, Mode.LAND):
            self._flight.enter(to if self._flight.refusal(to) is None else Mode.LAND)
