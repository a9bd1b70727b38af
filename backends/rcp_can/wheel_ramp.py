"""A speed change that both wheels complete in the same time, which keeps the curve."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rcp_can.pace import Pace

__all__ = ["WheelRamp"]


class WheelRamp:
    """Speeds that change linearly together.

    `pace` goes on from one ramp to the next: a command that is renewed in every cycle accelerates
    as one that is given once.
    """

    def __init__(
        self,
        start: Sequence[float],
        goal: Sequence[float],
        accelerations: Sequence[float | None],
        pace: Pace,
    ) -> None:
        self._start, self._goal, self._pace = start, goal, pace
        self._duration = max(
            abs(to - of) / limit if limit else 0.0
            for of, to, limit in zip(start, goal, accelerations, strict=True)
        )
        self._elapsed = 0.0

    def follow(self, wheel: int) -> Callable[[], tuple[float, float]]:
        """Return a path for `Axis.command` in mode velocity, which has no position."""
        of, to = self._start[wheel], self._goal[wheel]

        def now() -> tuple[float, float]:
            return 0.0, of + (to - of) * self._part(wheel)

        return now

    def _part(self, wheel: int) -> float:
        self._elapsed += self._pace.advance(wheel)
        return min(self._elapsed / self._duration, 1.0) if self._duration else 1.0
