"""How much time the machine's other work takes from what a test measures."""

from __future__ import annotations

import threading
import time
from collections.abc import Generator
from contextlib import contextmanager

__all__ = ["Load", "measured_load"]

_WORK = 0.002  # s of the processor that a measurement takes
_PAUSE = 0.02  # s between two


class Load:
    """The time that a thread lost which sleeps and works in turn."""

    lost = 0.0
    """Seconds by which it woke late, or in which it had work and no processor."""

    def allows(self, bound: float, most: float) -> float:
        """Return a bound, longer by what was lost, but by no more than `most` seconds."""
        return bound + min(self.lost, most)


@contextmanager
def measured_load() -> Generator[Load]:
    """Measure the load while entered."""
    load, over = Load(), threading.Event()

    def measure() -> None:
        began = time.perf_counter()
        while not over.wait(_PAUSE):
            work = time.thread_time()
            while (done := time.thread_time() - work) < _WORK:
                pass
            ended = time.perf_counter()
            load.lost += max(0.0, ended - began - _PAUSE - done)
            began = ended

    measuring = threading.Thread(target=measure)
    measuring.start()
    try:
        yield load
    finally:
        over.set()
        measuring.join()
