"""Explains a refusal without a text by the vehicle's telemetry."""

from __future__ import annotations

from typing import NamedTuple

from rcp_mavlink.vehicle import Vehicle

__all__ = ["Reason", "silent_reason"]

_ARM, _TAKEOFF, _REBOOT = 400, 22, 246  # MAV_CMD


class Reason(NamedTuple):
    """A reason and its remedy."""

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
    """Explain why a command (`first` is its first parameter) was refused; None if unknown."""
    flying = vehicle.landed is False
    if number == _ARM and not first and flying:
        return _IN_AIR_DISARM
    if number == _TAKEOFF:
        return _IN_AIR_TAKEOFF if flying else None if vehicle.armed else _NOT_ARMED
    return _ARMED if number == _REBOOT and vehicle.armed else None
