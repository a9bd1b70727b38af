"""Time that a test puts forward, so that nothing waits for a lease, a window or an age to pass."""

from __future__ import annotations

import asyncio
import time

from rcp_kernel.clock import Clock

__all__ = ["SteppedClock", "SteppedLoop", "UnguardedLoop"]


class SteppedClock:
    """Goes as the machine's clock does, and is put forward by `advance`.

    It never stands still: a gateway under test is a real one, with threads, sockets and short
    timers. So what a test asks for is far apart: of a lease for 300 s much is left after
    `advance(200)`, on the slowest machine, and nothing after another.
    """

    def __init__(self) -> None:
        self.ahead = 0.0
        """Seconds that it was put forward in all."""
        self.adjusted = 0.0
        """Seconds by which its wall time alone was set forward (or back) in all."""
        self.clock = Clock(self.now, self.monotonic)
        """As a gateway takes it."""

    def now(self) -> int:
        """Return the wall time, ns since the UNIX epoch."""
        return time.time_ns() + int((self.ahead + self.adjusted) * 1e9)

    def monotonic(self) -> float:
        """Return the seconds since some moment."""
        return time.monotonic() + self.ahead

    def advance(self, seconds: float) -> None:
        """Put it forward; timers that are due then run in the loop's next turns.

        :raises ValueError: that is backwards.
        """
        if seconds < 0:
            raise ValueError(f"a clock goes forward, not {seconds} s")
        self.ahead += seconds

    def adjust(self, seconds: float) -> None:
        """Set its wall time forward, or back if negative, as NTP or a person would."""
        self.adjusted += seconds


class SteppedLoop(asyncio.SelectorEventLoop):
    """An event loop whose timers follow a stepped clock."""

    def __init__(self, clock: SteppedClock) -> None:
        self._monotonic = clock.monotonic
        super().__init__()

    def time(self) -> float:
        """Return the clock's time."""
        return self._monotonic()


class UnguardedLoop(asyncio.SelectorEventLoop):
    """An event loop that goes by a time of its own: `serve` starts no guard, a process by the machine's."""
