"""Garbage collection while nothing moves: a full collection in a large gateway takes a second.

Reference counting frees nearly everything at once. For the remaining cycles Python visits all
objects of the process, during which no e-stop and no dead-man is handled.
"""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable, Generator
from contextlib import contextmanager

__all__ = ["collected_at_rest"]

_THRESHOLDS = (2_000, 50_000, 10)
"""Collecting the youngest generation takes some milliseconds; older ones are collected only when
the
process has gained a hundred million objects without ever being at rest."""
_LOOK = 5.0  # s between two checks for motion
_EVERY = 12  # checks at rest between two collections


@contextmanager
def collected_at_rest(
    loop: asyncio.AbstractEventLoop, moving: Callable[[], bool]
) -> Generator[None]:
    """Collect garbage only while nothing is `moving`; objects that exist now are frozen."""
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
