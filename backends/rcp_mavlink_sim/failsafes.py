"""Failsafes: battery, ground station, transmitter, GPS; with the texts of ArduPilot."""

from __future__ import annotations

from rcp_mavlink_sim.flight import Flight
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.state import VehicleState

__all__ = ["Failsafes"]

_RADIO_LATE = 1.5  # s without pulses from the receiver
_BLIND = 1.0  # s without a position
_LAND_ON_GCS, _LAND_ON_RADIO, _LAND_ON_LOW = 5, 3, 1
_BRAKE_ON_GCS, _HOLD_ON_EKF = 7, 2
_IN_AUTO, _WHILE_LANDING, _IN_PILOTED = 1 << 1, 1 << 3, 1 << 4  # bits of FS_OPTIONS
_PILOTED = frozenset({Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER, Mode.POSHOLD, Mode.BRAKE})


class Failsafes:
    """The active failsafes and their actions."""

    def __init__(self, vehicle: VehicleState, flight: Flight) -> None:
        self._vehicle, self._flight = vehicle, flight
        self.battery_low = self.battery_critical = False
        self.station_lost = self.radio_lost = self.blind = False
        self._station_seen = False
        self._last_heartbeat = 0.0
        self._low_for = self._critical_for = self._radio_gone = self._blind_for = 0.0

    @property
    def any(self) -> bool:
        """Whether any failsafe is active."""
        return self.battery_low or self.station_lost or self.radio_lost or self.blind

    def check(self, seconds: float) -> None:
        """Check all failsafes; `seconds` of simulated time have passed."""
        self._battery(seconds)
        self._station()
        self._radio(seconds)
        self._position(seconds)

    def on_station_heartbeat(self) -> None:
        """Handle a heartbeat of the ground station that it accepts."""
        self._last_heartbeat, self._station_seen = self._vehicle.wall, True
        if self.station_lost:
            self.station_lost = False
            self._vehicle.send_text(4, "GCS Failsafe Cleared")

    def act(self, why: str, *, return_home: bool, to: Mode | None = None) -> None:
        """Return home, or land if the way home is unknown; report it in ArduPilot's words.

        `to` is the mode for it, if that can be entered.
        """
        vehicle, flight = self._vehicle, self._flight
        copter = vehicle.kind.name == "copter"
        goes_on = not copter or int(vehicle.params["FS_OPTIONS"]) & _WHILE_LANDING
        if vehicle.kind.flies and vehicle.body.landed:
            vehicle.send_text(4, f"{why} Failsafe - Disarming")
            flight.disarm()
            return
        if vehicle.kind.flies and flight.landing and goes_on:
            vehicle.send_text(4, f"{why} Failsafe - Continuing Landing")
            return
        vehicle.send_text(4, f"{why} Failsafe")
        flight.retreat(return_home=return_home, to=to)

    def _battery(self, seconds: float) -> None:
        vehicle, p = self._vehicle, self._vehicle.params
        self._low_for = self._low_for + seconds if self._below("LOW") else 0.0
        self._critical_for = self._critical_for + seconds if self._below("CRT") else 0.0
        used = f"{vehicle.battery.voltage:.2f}V used {vehicle.battery.consumed:.0f} mAh"
        if not self.battery_low and self._low_for >= p["BATT_LOW_TIMER"]:
            self.battery_low = True
            vehicle.send_text(4, f"Battery 1 is low {used}")
            if vehicle.armed and (action := p["BATT_FS_LOW_ACT"]):
                self.act("Battery", return_home=action != _LAND_ON_LOW)
        if not self.battery_critical and self._critical_for >= p["BATT_LOW_TIMER"]:
            self.battery_critical = True
            vehicle.send_text(2, f"Battery 1 is critical {used}")
            if vehicle.armed and (action := p["BATT_FS_CRT_ACT"]):
                self.act("Battery", return_home=action != _LAND_ON_LOW)

    def _below(self, level: str) -> bool:
        p, battery = self._vehicle.params, self._vehicle.battery
        volts, left = p[f"BATT_{level}_VOLT"], p[f"BATT_{level}_MAH"]
        empty = left > 0 and battery.consumed > p["BATT_CAPACITY"] - left
        return empty or (volts > 0 and battery.voltage < volts)

    def _station(self) -> None:
        vehicle, p = self._vehicle, self._vehicle.params
        late = vehicle.wall - self._last_heartbeat > p[vehicle.kind.param("FS_GCS_TIMEOUT")]
        if self.station_lost or not (
            self._station_seen and late and p[vehicle.kind.param("FS_GCS_ENABLE")]
        ):
            return
        self.station_lost = True
        if not vehicle.armed:
            vehicle.send_text(4, "GCS Failsafe")
        elif (going_on := self._goes_on()) is not None:
            vehicle.send_text(4, f"GCS Failsafe - Continuing {going_on}")
        elif (action := p[vehicle.kind.param("FS_GCS_ENABLE")]) == _BRAKE_ON_GCS:
            self.act("GCS", return_home=False, to=Mode.BRAKE)
        else:
            self.act("GCS", return_home=action != _LAND_ON_GCS)

    def _goes_on(self) -> str | None:
        """Return what a copter continues despite the loss of its ground station."""
        vehicle = self._vehicle
        if vehicle.kind.name != "copter" or vehicle.body.landed or self._flight.landing:
            return None
        options, mode = int(vehicle.params["FS_OPTIONS"]), self._flight.mode
        if mode is Mode.AUTO and options & _IN_AUTO:
            return "Auto Mode"
        return "Pilot Control" if mode in _PILOTED and options & _IN_PILOTED else None

    def _radio(self, seconds: float) -> None:
        vehicle, p = self._vehicle, self._vehicle.params
        gone = bool(p["SIM_RC_FAIL"]) and not vehicle.sticks.held
        self._radio_gone = self._radio_gone + seconds if gone else 0.0
        if self.radio_lost and not gone:
            self.radio_lost = False
            vehicle.send_text(4, "Radio Failsafe Cleared")
        elif (
            not self.radio_lost
            and self._radio_gone > _RADIO_LATE
            and p[vehicle.kind.param("FS_THR_ENABLE")]
        ):
            self.radio_lost = True
            if vehicle.armed:
                self.act(
                    "Radio", return_home=p[vehicle.kind.param("FS_THR_ENABLE")] != _LAND_ON_RADIO
                )
            else:
                vehicle.send_text(4, "Radio Failsafe")

    def _position(self, seconds: float) -> None:
        vehicle = self._vehicle
        gone = vehicle.home is not None and not vehicle.position_ok
        self._blind_for = self._blind_for + seconds if gone else 0.0
        if self.blind and not gone:
            self.blind = False
            vehicle.send_text(4, "EKF Failsafe Cleared")
        elif not self.blind and self._blind_for > _BLIND and vehicle.armed:
            self.blind = True
            vehicle.send_text(2, "EKF variance: position horizontal")
            action = vehicle.params["FS_EKF_ACTION"] if vehicle.kind.name == "copter" else 1
            if self._flight.mode not in (Mode.STABILIZE, Mode.ALT_HOLD) and action:
                to = Mode.ALT_HOLD if action == _HOLD_ON_EKF else None
                self.act("EKF", return_home=False, to=to)
