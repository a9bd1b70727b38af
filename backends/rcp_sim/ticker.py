"""Ticks of a steady rate: scheduled from the start and not from the last, so they never drift."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable

import anyio

__all__ = ["run_ticks"]

_LATE = 0.25  # s that are caught up
_NAP = 0.001  # s: timers of the event loop are no finer, and asking for less would spin


async def run_ticks(
    tick: Callable[[int], None],
    rate: float,
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], Awaitable[None]] = anyio.sleep,
    wall: Callable[[], int] = time.time_ns,
) -> None:
    """Call `tick(timestamp)` `rate` times a second until cancelled; timestamps are ns of UTC.

    A rate above what timers can do is kept by several ticks at a wake-up, each with its own time.
    So is a delay made up for, unless it is so long that the process must have stood still.
    """
    period = 1 / rate
    most = max(1, int(_LATE * rate))
    start, count = clock(), 0
    while True:
        await sleep(max(_NAP, start + (count + 1) * period - clock()))
        moment, stamp = clock(), wall()
        due = int((moment - start) * rate + 1e-6) - count
        if due > most:
            # The process stood still, and the world with it: nothing of that is made up for, or the
            # rover would drive on blindly before the dead-man, due long ago, has its turn.
            start += (due - 1) * period
            due = 1
        for _ in range(due):
            count += 1
            late = moment - (start + count * period)
            tick(stamp - int(late * 1e9))
