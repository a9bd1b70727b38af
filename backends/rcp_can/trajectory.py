"""A trajectory shared by several joints, on a clock that a late host only slows down."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from rcp_can.cubic import Cubic
from rcp_can.pace import Pace

__all__ = ["Trajectory"]

_NOTHING = 1e-9
_AT_REST = 1e-3  # fraction of the planned speed below which a braked trajectory ends


class Trajectory:
    """Curves on one clock, which advances as the joints query it.

    A late host delays the joints and never makes them jump: from one of its queries to the next,
    no joint goes on by more than `late` s.
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
        self.duration, self._late, self._pace = duration, late, Pace(late, clock)
        self.elapsed = 0.0
        """The current time on the trajectory, s."""
        self._rate, self._braking = 1.0, False

    def follow(self, joint: int) -> Callable[[], tuple[float, float]]:
        """Return a function that gives the current position and velocity of one joint."""
        curve, reached = self._curves[joint], 0.0

        def now() -> tuple[float, float]:
            nonlocal reached
            self._advance(self._pace.advance(joint))
            # Several cycles of a faster joint may lie between two of this one.
            reached = min(self.elapsed, reached + self._late)
            sample = curve.at(reached)
            return sample.position, 0.0 if self.over else sample.velocity * self._rate

        return now

    def _advance(self, dt: float) -> None:
        if self._braking and self._rate and dt:
            rate = max(0.0, self._rate + self._deceleration() * dt)
            self._rate = 0.0 if rate < _AT_REST else rate
        self.elapsed = min(self.elapsed + self._rate * dt, self.duration)

    @property
    def over(self) -> bool:
        """Whether it has ended, at the goal or braked."""
        return self.elapsed >= self.duration or self._rate == 0.0

    def brake(self) -> None:
        """Come to rest on the curves, as early as the joints' accelerations allow."""
        self._braking = True

    def _deceleration(self) -> float:
        """Return the possible change of the time scale, 1/s: all joints stay on their curves.

        The acceleration of a joint is that of its curve times the scale squared, plus the velocity
        of its curve times the returned value; without the latter it is within its limit.
        """
        lowest = -1.0 / self._late  # at most in one period
        for curve, limit in zip(self._curves, self._accelerations, strict=True):
            sample = curve.at(self.elapsed)
            bent = sample.acceleration * self._rate**2
            if abs(sample.velocity) > _NOTHING:
                bounds = [(side * limit - bent) / sample.velocity for side in (1, -1)]
                lowest = max(lowest, min(bounds))
        return min(lowest, 0.0)
