"""The modes of an ArduCopter that the twin flies, and what each asks for before it can be armed."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["Mode", "armable", "needs_position"]


class Mode(IntEnum):
    """Custom mode numbers of ArduCopter."""

    STABILIZE = 0
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    POSHOLD = 16
    BRAKE = 17


_NOT_ARMABLE = frozenset({Mode.RTL, Mode.LAND, Mode.BRAKE})
_BLIND = frozenset({Mode.STABILIZE, Mode.ALT_HOLD, Mode.LAND})


def armable(mode: Mode) -> bool:
    """Tell whether the motors may be started in it."""
    return mode not in _NOT_ARMABLE


def needs_position(mode: Mode) -> bool:
    """Tell whether it flies by position and thus waits for GPS and EKF."""
    return mode not in _BLIND
