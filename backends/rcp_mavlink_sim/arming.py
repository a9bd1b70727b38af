"""Pre-arm checks, with the texts of ArduPilot."""

from __future__ import annotations

from rcp_mavlink_sim.calibrations import Calibrations
from rcp_mavlink_sim.failsafes import Failsafes
from rcp_mavlink_sim.fence import Fence
from rcp_mavlink_sim.flight import Flight
from rcp_mavlink_sim.modes import Mode, armable, needs_position
from rcp_mavlink_sim.state import VehicleState

__all__ = ["complaints", "mode_complaint"]

_ARM_IN_AUTO = 1
_ARM_BY_STICKS = 1  # of GUID_OPTIONS
_GYROS, _HOME = 0.2, 0.5  # fractions of the warm-up time


def complaints(
    vehicle: VehicleState,
    flight: Flight,
    failsafes: Failsafes,
    fence: Fence,
    calibrations: Calibrations,
) -> list[str]:
    """List what prevents arming, in ArduPilot's words; empty if it may arm."""
    found = ["RC calibrating"] if calibrations.radio else list[str]()
    if not vehicle.params["ARMING_CHECK"]:
        return found
    warm = vehicle.time / vehicle.options.warmup if vehicle.options.warmup > 0 else 1.0
    if warm < _GYROS:
        found.append("Gyros inconsistent")
    elif warm < _HOME:
        found.append("AHRS: waiting for home")
    elif not vehicle.position_ok and needs_position(flight.mode):
        found.append("Need Position Estimate")
    lowest = vehicle.params["BATT_ARM_VOLT"]
    if lowest and vehicle.battery.voltage < lowest:
        found.append("Battery 1 below minimum arming voltage")
    if failsafes.radio_lost:
        found.append("Radio failsafe on")
    if failsafes.battery_low and vehicle.params["BATT_FS_LOW_ACT"]:
        found.append("Battery 1 low voltage failsafe")
    if vehicle.params["FENCE_ENABLE"] and fence.breached:
        found.append("vehicle outside fence")
    return found


def mode_complaint(vehicle: VehicleState, flight: Flight, *, by_sticks: bool = False) -> str | None:
    """Return what prevents arming in the present mode."""
    mode = flight.mode
    if not armable(mode) or (by_sticks and not _takes_sticks(vehicle, mode)):
        return f"{mode.name} mode not armable"
    if mode is Mode.AUTO and not flight.mission.flyable:
        return "Mode requires mission"
    copter = vehicle.kind.name == "copter"
    if mode is Mode.AUTO and copter and not int(vehicle.params["AUTO_OPTIONS"]) & _ARM_IN_AUTO:
        return "AUTO mode not armable"
    return None


def _takes_sticks(vehicle: VehicleState, mode: Mode) -> bool:
    """Return whether sticks may arm it: not a copter in GUIDED, unless its options say so."""
    if vehicle.kind.name != "copter" or mode is not Mode.GUIDED:
        return True
    return bool(int(vehicle.params["GUID_OPTIONS"]) & _ARM_BY_STICKS)
