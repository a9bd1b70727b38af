"""The window of long messages: as much as a link takes without a queue that others would wait in."""

from __future__ import annotations

import time
from collections import deque

__all__ = ["DelayWindow"]

_TARGET = 0.008  # s that parts may wait for each other on the way
_MOST = 393_216  # bytes: 8 batches of Zenoh, each with three parts
_DRIFT = 1.01  # the least delay may grow with the route


class DelayWindow:
    """Halves when acknowledgements come later than those of a lone part, else grows."""

    __slots__ = ("_flight", "_least", "_rest", "_step", "size")

    def __init__(self, step: int) -> None:
        self._step = step
        """Bytes of one part: the least size of the window."""
        self.size = 4 * step
        self._flight: deque[tuple[int, float]] = deque()
        self._least = 1e9
        self._rest = 0.0

    def sent(self, total: int) -> None:
        """Note that so many bytes were sent until now."""
        self._flight.append((total, time.monotonic()))

    def taken(self, total: int) -> None:
        """Note that so many bytes have arrived until now."""
        moment, at = time.monotonic(), None
        while self._flight and self._flight[0][0] <= total:
            _, at = self._flight.popleft()
        if at is None:
            return
        delay = moment - at
        self._least = min(delay, self._least * _DRIFT)
        if delay <= self._least + _TARGET:
            self.size = min(_MOST, self.size + self._step // 2)
        elif moment > self._rest:
            self.size = max(self._step, self.size // 2)
            self._rest = moment + delay  # the effect shows after a round trip
