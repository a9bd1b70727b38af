"""Garbage is collected while nothing moves: looking through a full gateway takes a second.

Counting references frees nearly everything at once. What is left are cycles, for which Python goes
through all objects of the process, and no e-stop or dead-man is heard meanwhile.
"""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable, Generator
from contextlib import contextmanager

__all__ = ["collected_at_rest"]

_THRESHOLDS = (2_000, 50_000, 10)
"""The youngest objects are looked through in some milliseconds; older ones only when the process
has gained a hundred million without ever resting."""
_LOOK = 5.0  # s between looks whether something moves
_EVERY = 12  # looks at rest from one collection to the next


@contextmanager
def collected_at_rest(
    loop: asyncio.AbstractEventLoop, moving: Callable[[], bool]
) -> Generator[None]:
    """Collect all garbage only while nothing is `moving`; what is there now is never looked at."""
    before = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(*_THRESHOLDS)
    rested = 0
    timer: asyncio.TimerHandle

    def look() -> None:
        nonlocal rested, timer
        if not moving():
            rested += 1
            if rested >= _EVERY:
                rested = 0
                gc.collect()
        timer = loop.call_later(_LOOK, look)

    timer = loop.call_later(_LOOK, look)
    try:
        yield
    finally:
        timer.cancel()
        gc.set_threshold(*before)
        gc.unfreeze()
