"""The flight modes, and what each requires for arming."""

from __future__ import annotations

from enum import Enum, auto

__all__ = ["Mode", "armable", "needs_position"]


class Mode(Enum):
    """Modes by name; their numbers depend on the kind of vehicle."""

    MANUAL = auto()
    STABILIZE = auto()
    STEERING = auto()
    ALT_HOLD = auto()
    FBWA = auto()
    FBWB = auto()
    CRUISE = auto()
    AUTO = auto()
    GUIDED = auto()
    LOITER = auto()
    CIRCLE = auto()
    TAKEOFF = auto()
    RTL = auto()
    SMART_RTL = auto()
    LAND = auto()
    POSHOLD = auto()
    BRAKE = auto()
    HOLD = auto()
    FOLLOW = auto()
    OFFBOARD = auto()


_NOT_ARMABLE = frozenset({Mode.RTL, Mode.SMART_RTL, Mode.LAND, Mode.BRAKE, Mode.FOLLOW})
_BLIND = frozenset(
    {Mode.MANUAL, Mode.STABILIZE, Mode.ALT_HOLD, Mode.LAND, Mode.FBWA, Mode.FBWB, Mode.HOLD}
)


def armable(mode: Mode) -> bool:
    """Return whether the vehicle can be armed in a mode."""
    return mode not in _NOT_ARMABLE


def needs_position(mode: Mode) -> bool:
    """Return whether a mode needs a position and thus waits for GPS and EKF."""
    return mode not in _BLIND
