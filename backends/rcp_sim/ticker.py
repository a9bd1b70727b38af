"""Ticks at a steady rate, scheduled from the start so that they never drift."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable

import anyio

__all__ = ["run_ticks"]

_LATE = 0.25  # s of delay that are caught up
_NAP = 0.001  # s: event loop timers are no finer, and a shorter sleep would spin


async def run_ticks(
    tick: Callable[[int], None],
    rate: float,
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], Awaitable[None]] = anyio.sleep,
    wall: Callable[[], int] = time.time_ns,
) -> None:
    """Call `tick(timestamp)` `rate` times per second until cancelled; timestamps are UTC, ns.

    A rate above the resolution of timers, or a short delay, is kept by several ticks per wake-up,
    each with its own time. After a long delay the process must have been suspended: no catching up.
    """
    period = 1 / rate
    most = max(1, int(_LATE * rate))
    start, count = clock(), 0
    while True:
        await sleep(max(_NAP, start + (count + 1) * period - clock()))
        moment, stamp = clock(), wall()
        due = int((moment - start) * rate + 1e-6) - count
        if due > most:
            # The process was suspended and the world with it. Catching up would let the rover drive
            # on blindly before the overdue dead-man can act.
            start += (due - 1) * period
            due = 1
        for _ in range(due):
            count += 1
            late = moment - (start + count * period)
            tick(stamp - int(late * 1e9))
