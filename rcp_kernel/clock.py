"""The gateway's clock, and the format of times on the wire."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from rcp_protocol.clock import (
    iso,
    iso_bytes,
    now,
    parse_time,
)

__all__ = [
    "SYSTEM_CLOCK",
    "Clock",
    "Lateness",
    "iso",
    "iso_bytes",
    "now",
    "parse_time",
]


@dataclass(frozen=True, slots=True)
class Clock:
    """The time by which rules decide: ages, deadlines, leases, quotas, what expires.

    The gateway has one, and the event loop's `time()` runs with it. Keep the function that is
    needed where it is called often. What only writes a time down, or measures how long work takes,
    reads the machine's clock itself.
    """

    now: Callable[[], int] = time.time_ns
    """Wall time, ns since the UNIX epoch; it may be set."""
    monotonic: Callable[[], float] = time.monotonic
    """Seconds since some moment; never set."""


SYSTEM_CLOCK = Clock()

_WINDOW = 10.0  # s: clocks that are kept drift apart by less than 1 ms in it
_RISE = 0.1  # s by which the least difference of a window rises only with a slow clock or link
_RISES = 2  # windows in a row, after which the clock counts as slow


class Lateness:
    """How late stamped samples of one device arrive, whatever its clock shows.

    The least difference of arrival and stamp in the last 10 to 20 s bounds the difference of the
    clocks: nothing arrives before it was measured. A delay that is constant cannot be seen, nor
    any of a clock that runs slowly, as in a simulation below real time.
    """

    def __init__(self, most: float = 10.0) -> None:
        """Take a sample that is later than `most` (s) for one of a clock that was set back."""
        self._most = most
        self._least: float | None = None
        self._before: float | None = None
        """The least difference of this window and of the one before, s."""
        self._began = 0.0
        self._rises = 0

    def of(self, apart: float, now: float) -> float:
        """Return by how much (s) a sample is later than the promptest.

        `apart` is the difference of its arrival and its stamp in s, `now` monotonic.
        """
        if self._least is None:
            self._least, self._began = apart, now
        elif now - self._began > _WINDOW:
            rose = self._before is not None and self._least - self._before > _RISE
            self._rises = self._rises + 1 if rose else 0
            self._before, self._least, self._began = self._least, apart, now
        self._least = min(self._least, apart)
        least = self._least if self._before is None else min(self._least, self._before)
        if apart - least > self._most:
            self._before, self._least, self._began = None, apart, now
            return 0.0
        return 0.0 if self._rises >= _RISES else apart - least
