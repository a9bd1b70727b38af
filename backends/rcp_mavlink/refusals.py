"""Why a vehicle refused a command without a word, by what its telemetry shows."""

from __future__ import annotations

from typing import NamedTuple

from rcp_mavlink.vehicle import Vehicle

__all__ = ["Reason", "silent_reason"]

_ARM, _TAKEOFF, _REBOOT = 400, 22, 246  # MAV_CMD


class Reason(NamedTuple):
    """A reason, and what to do about it."""

    reason: str
    remedy: str


_IN_AIR_DISARM = Reason(
    "the vehicle is in the air",
    "Land it first with action/land; action/disarm with `force` lets it fall.",
)
_IN_AIR_TAKEOFF = Reason("the vehicle is already in the air", "Use action/move_to to climb.")
_NOT_ARMED = Reason("the vehicle is not armed", "Arm it first.")
_ARMED = Reason("the vehicle is armed", "Disarm it first.")


def silent_reason(vehicle: Vehicle, number: int, first: float) -> Reason | None:
    """Say why a command (`first` is its first parameter) was refused; None: nothing shows it."""
    flying = vehicle.landed is False
    if number == _ARM and not first and flying:
        return _IN_AIR_DISARM
    if number == _TAKEOFF:
        return _IN_AIR_TAKEOFF if flying else None if vehicle.armed else _NOT_ARMED
    return _ARMED if number == _REBOOT and vehicle.armed else None
