"""The gateway's clock, and the format of times on the wire."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from rcp_protocol.clock import iso, iso_bytes, now, parse_time

__all__ = ["SYSTEM_CLOCK", "Clock", "iso", "iso_bytes", "now", "parse_time"]


@dataclass(frozen=True, slots=True)
class Clock:
    """The time by which rules decide: ages, deadlines, leases, quotas, what expires.

    The gateway has one, and the event loop's `time()` runs with it. Keep the function that is
    needed where it is called often. Code that only records a time, or measures how long work takes,
    reads the machine's clock itself.
    """

    now: Callable[[], int] = time.time_ns
    """Wall time, ns since the UNIX epoch; it may be set."""
    monotonic: Callable[[], float] = time.monotonic
    """Seconds since some moment; never set."""


SYSTEM_CLOCK = Clock()
