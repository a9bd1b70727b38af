"""How homing goes on, as the statusword tells (CiA 402-2, table 129)."""

from __future__ import annotations

from enum import Enum

__all__ = ["Homing", "homing_of"]

_REACHED, _ATTAINED, _ERROR = 1 << 10, 1 << 12, 1 << 13
_STARTED = 0.5  # s after which a drive that has not started homing will not


class Homing(Enum):
    """The state of homing, as text for a person."""

    RUNNING = "it goes on"
    DONE = "it is done"
    NOT_STARTED = "the drive did not start it, or interrupted it; check the method"
    FAILED = "the drive reports a homing error"


def homing_of(statusword: int, since: float) -> Homing:
    """Return the state of homing `since` s after it was requested."""
    if statusword & _ERROR:
        return Homing.FAILED
    match bool(statusword & _ATTAINED), bool(statusword & _REACHED):
        case (True, True):
            return Homing.DONE
        case (False, True) if since > _STARTED:
            return Homing.NOT_STARTED
        case _:
            return Homing.RUNNING
