"""States and results of an ODrive's axis, firmware 0.5.6 to 0.6."""

from __future__ import annotations

__all__ = ["CALIBRATIONS", "HOMING", "PREPARING", "SELF_MOVING", "STATES", "reason"]

HOMING = 11

CALIBRATIONS = {
    "full": 3,
    "motor": 4,
    "index_search": 6,
    "encoder_offset": 7,
    "encoder_direction": 10,
    "hall_polarity": 12,
    "hall_phase": 13,
    "anticogging": 14,
}
"""The states that calibrate something."""
PREPARING = frozenset((2, *CALIBRATIONS.values(), 9))
"""States of a calibration, and those that belong to one: start-up, lock-in."""
SELF_MOVING = PREPARING | {HOMING}
"""States in which the axis turns by itself. Homing takes a velocity, but goes on by itself as soon as
the end stop closes; only another state ends any of them."""
STATES = {
    0: "undefined",
    1: "idle",
    2: "startup",
    8: "closed_loop",
    9: "lockin_spin",
    HOMING: "homing",
    **{state: name for name, state in CALIBRATIONS.items()},
}
_RESULTS = {
    2: "it was cancelled",
    3: "the drive was disarmed",
    4: "no response of the encoder",
    5: "pole pairs and encoder resolution do not match",
    6: "phase resistance out of range",
    7: "phase inductance out of range",
    8: "unbalanced phases",
    9: "invalid motor type",
    10: "illegal state of the hall sensors",
    11: "time-out",
    12: "homing without an end stop",
    13: "invalid state",
    14: "not calibrated",
    15: "it does not converge",
}


def reason(result: int) -> str | None:
    """Return why a procedure failed, by its result; None if it succeeded, or still runs."""
    return None if result in (0, 1) else _RESULTS.get(result, f"result {result}")
