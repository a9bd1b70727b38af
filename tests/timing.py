"""Bounds on time: other programs on the machine may break one now and then, but not in each of three attempts."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Awaitable, Callable, Generator
from contextlib import contextmanager
from typing import ParamSpec

__all__ = ["Load", "in_one_of_three_attempts", "in_time", "measured_load"]

_ATTEMPTS = 3
_WORK = 0.004  # s of the processor that a measurement takes
_PAUSE = 0.04  # s between two
_Asked = ParamSpec("_Asked")


class _LateError(AssertionError):
    """It took too long."""


class Load:
    """How long work takes on a machine that has other work too."""

    worst = 1.0
    """Its time, by the time that it takes on a machine that has none."""

    def allows(self, bound: float, work: float = 0.2) -> float:
        """Return a bound that holds some seconds of work, longer by what the load makes of those."""
        return bound + (self.worst - 1.0) * work

    def note(self, took: float, work: float) -> None:
        """Note that so many seconds of the processor took so many seconds."""
        self.worst = max(self.worst, took / work)


@contextmanager
def measured_load() -> Generator[Load]:
    """Measure the load while entered."""
    load, over = Load(), threading.Event()

    def measure() -> None:
        while not over.wait(_PAUSE):
            began, work = time.perf_counter(), time.thread_time()
            while (done := time.thread_time() - work) < _WORK:
                pass
            load.note(time.perf_counter() - began, done)

    measuring = threading.Thread(target=measure)
    measuring.start()
    try:
        yield load
    finally:
        over.set()
        measuring.join()


def in_time(seconds: float, bound: float) -> None:
    """Have an attempt end if it took too long; whatever else fails ends the test."""
    if seconds >= bound:
        raise _LateError(f"it took {seconds:.3f} s, the bound is {bound:g} s")


def in_one_of_three_attempts(
    test: Callable[_Asked, Awaitable[None]],
) -> Callable[_Asked, Awaitable[None]]:
    """Try a test anew for as long as nothing but time spoke against it."""

    @functools.wraps(test)
    async def tried(*args: _Asked.args, **kwargs: _Asked.kwargs) -> None:
        for left in reversed(range(_ATTEMPTS)):
            try:
                await test(*args, **kwargs)
            except _LateError:
                if not left:
                    raise
            else:
                return

    return tried
