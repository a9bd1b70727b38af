"""How long threads keep the interpreter from the event loop."""

from __future__ import annotations

import sys

__all__ = ["take_short_turns"]

_TURN = 0.0005  # s; Python's own is 5 ms


def take_short_turns() -> None:
    """Have a thread that calculates give the interpreter up within half a millisecond.

    A request needs the interpreter several times until the robot is told, and waits for each: an e-stop
    beside a busy thread took 22 ms with Python's own turns.
    """
    sys.setswitchinterval(_TURN)
