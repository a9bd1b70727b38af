"""By how much the clocks of this process are ahead of the machine's; see `hurry`.

To be imported before anybody takes a function of `time` as a default. A latency is measured by
`perf_counter`, which stays what it is.
"""

from __future__ import annotations

import time

__all__ = ["AHEAD", "machine_time"]


class Ahead:
    """A lead that grows while a loop hurries, and ends with it."""

    seconds = 0.0
    booted = 0.0
    """When the machine booted, as far as the monotonic clock tells; see the fixture `boot`."""


AHEAD = Ahead()
machine_time = time.monotonic
_time, _time_ns = time.time, time.time_ns

time.monotonic = lambda: machine_time() + AHEAD.seconds - AHEAD.booted
time.time = lambda: _time() + AHEAD.seconds
time.time_ns = lambda: _time_ns() + int(AHEAD.seconds * 1e9)
