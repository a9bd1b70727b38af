"""A trajectory that several joints follow together, on one clock that a late host only slows down."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from rcp_can.cubic import Cubic

__all__ = ["Trajectory"]

_NOTHING = 1e-9
_AT_REST = 1e-3  # part of the planned speed below which a braked trajectory ends


class Trajectory:
    """Curves on one clock; time goes on with each look at it, by `late` s at most.

    A host that is late therefore makes the joints late, and never has them jump.
    """

    def __init__(
        self,
        curves: Sequence[Cubic],
        accelerations: Sequence[float],
        duration: float,
        late: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._curves, self._accelerations = curves, accelerations
        self.duration, self._late, self._clock = duration, late, clock
        self.elapsed = 0.0
        """The moment of the trajectory that is due, s."""
        self._rate, self._braking = 1.0, False
        self._last = clock()

    def follow(self, joint: int) -> Callable[[], tuple[float, float]]:
        """Return what tells the position and velocity of one joint now."""
        curve = self._curves[joint]

        def now() -> tuple[float, float]:
            self.advance()
            sample = curve.at(self.elapsed)
            return sample.position, 0.0 if self.over else sample.velocity * self._rate

        return now

    def advance(self) -> None:
        """Let time pass."""
        now = self._clock()
        dt, self._last = min(now - self._last, self._late), now
        if self._braking and self._rate:
            rate = max(0.0, self._rate + self._deceleration() * dt)
            self._rate = 0.0 if rate < _AT_REST else rate
        self.elapsed = min(self.elapsed + self._rate * dt, self.duration)

    @property
    def over(self) -> bool:
        """Whether it is at its end, or at rest on the way."""
        return self.elapsed >= self.duration or self._rate == 0.0

    def brake(self) -> None:
        """Come to rest on the way, as early as the joints' accelerations allow."""
        self._braking = True

    def _deceleration(self) -> float:
        """Return by how much the pace of time may change, 1/s: all joints stay on their curves.

        The acceleration of a joint is that of its curve times the pace squared, plus the velocity of its
        curve times what is returned; without the latter it is within its limit.
        """
        lowest = -1.0 / self._late  # in one period at most
        for curve, limit in zip(self._curves, self._accelerations, strict=True):
            sample = curve.at(self.elapsed)
            bent = sample.acceleration * self._rate**2
            if abs(sample.velocity) > _NOTHING:
                bounds = [(side * limit - bent) / sample.velocity for side in (1, -1)]
                lowest = max(lowest, min(bounds))
        return min(lowest, 0.0)
