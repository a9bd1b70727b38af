"""A speed change that both wheels complete in the same time, which keeps the curve."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

__all__ = ["WheelRamp"]

_LATE = 0.1  # s: a longer gap counts as this, so that no wheel jumps


class WheelRamp:
    """Speeds that change linearly together; each query advances time."""

    def __init__(
        self,
        start: Sequence[float],
        goal: Sequence[float],
        accelerations: Sequence[float | None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._start, self._goal, self._clock = start, goal, clock
        self._duration = max(
            abs(to - of) / limit if limit else 0.0
            for of, to, limit in zip(start, goal, accelerations, strict=True)
        )
        self._elapsed, self._last = 0.0, clock()

    def follow(self, wheel: int) -> Callable[[], tuple[float, float]]:
        """Return a path for `Axis.command` in mode velocity, which has no position."""
        of, to = self._start[wheel], self._goal[wheel]

        def now() -> tuple[float, float]:
            return 0.0, of + (to - of) * self._part()

        return now

    def _part(self) -> float:
        now = self._clock()
        self._elapsed += min(now - self._last, _LATE)
        self._last = now
        return min(self._elapsed / self._duration, 1.0) if self._duration else 1.0
