"""How the writer's thread shares the interpreter with the event loop."""

from __future__ import annotations

import time

__all__ = ["take_turns"]

_TURN = 64  # messages: less than 0.2 ms
_PAUSE = 0.0002  # s


def take_turns(count: int) -> None:
    """Let the event loop go on, if it wants to, after some of `count` messages.

    Without that it would wait until the interpreter takes the thread's turn away, 5 ms later.
    """
    if count % _TURN == 0:
        time.sleep(_PAUSE)
