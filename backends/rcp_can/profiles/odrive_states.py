"""States and results of an ODrive's axis, firmware 0.5.6 to 0.6."""

from __future__ import annotations

__all__ = ["CALIBRATIONS", "HOMING", "PREPARING", "SELF_MOVING", "STATES", "History", "reason"]

HOMING = 11
_HEARTBEATS = 2  # that may predate a request
_UNSEEN = 0.25  # s between two heartbeats in which no procedure comes and goes
_KEPT = 64  # states, beyond any procedure

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


class History:
    """What an axis went through since a procedure was requested, heartbeat by heartbeat.

    After a stall of the gateway all of a procedure may come in one batch of frames.
    """

    def __init__(self) -> None:
        self.states: list[int] = []
        """Each state that it entered."""
        self.ran = False
        """Whether a result was reported that was not there before, so that something ran."""
        self._unsettled = 0
        self._result = 0
        self._began = self._last = float("-inf")
        self._gap = 0.0

    @property
    def settled(self) -> bool:
        """Whether the last heartbeat tells what came of the request."""
        return self._unsettled == 0

    @property
    def complete(self) -> bool:
        """Whether nothing can have run between two heartbeats."""
        return self._gap <= _UNSEEN

    def begin(self, result: int, now: float) -> None:
        """Begin anew with a request; `result` is that of whatever ran before, `now` monotonic."""
        self.states, self.ran, self._result = [], False, result
        self._unsettled, self._gap = _HEARTBEATS, 0.0
        self._began = self._last = now

    def add(self, state: int, result: int, received: float, *, sent: bool) -> None:
        """Take a heartbeat by the monotonic time when it was received.

        `sent` is whether no frame waits to be sent: until then the request may be among them.
        """
        if received <= self._began:
            return
        self._gap, self._last = max(self._gap, received - self._last), received
        if sent:
            self._unsettled = max(0, self._unsettled - 1)
        if self.states[-1:] != [state] and len(self.states) < _KEPT:
            self.states.append(state)
        self.ran |= result != self._result or state in SELF_MOVING
