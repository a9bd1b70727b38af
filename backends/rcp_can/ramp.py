"""Set-points without jumps: velocity by acceleration, position by a trapezoidal profile."""

from __future__ import annotations

import math
from collections.abc import Callable

from rcp_can.codec import clamp

__all__ = ["Ramp"]


class Ramp:
    """A point that follows a target within velocity and acceleration limits.

    Without an acceleration limit, its velocity changes in one step.
    """

    def __init__(self, velocity: float, acceleration: float | None) -> None:
        self.position = self.velocity = 0.0
        self._limit, self._acceleration = velocity, acceleration
        self.limit = velocity
        """The current velocity limit, rad/s; a move may lower it."""
        self.path: Callable[[], tuple[float, float]] | None = None
        """A path that gives position and velocity instead of the ramp, if one is set."""

    @property
    def braking(self) -> float:
        """Signed distance until it can be at rest, rad."""
        if self._acceleration is None:
            return 0.0
        return self.velocity * abs(self.velocity) / 2 / self._acceleration

    def start(self, position: float, velocity: float) -> None:
        """Start at the measured position and velocity of the joint."""
        self.position, self.velocity = position, velocity
        self.limit, self.path = self._limit, None

    def to_velocity(self, target: float, dt: float) -> float:
        """Advance towards a velocity by `dt` s; return the set-point."""
        self.velocity = self._towards(clamp(target, -self.limit, self.limit), dt)
        return self.velocity

    def to_position(self, target: float, dt: float) -> float:
        """Advance towards a position by `dt` s; return the set-point."""
        if self.path is not None:
            self.position, self.velocity = self.path()
            return self.position
        left = target - self.position
        acceleration = self._acceleration
        wanted = self.limit
        if acceleration is not None:
            # The velocity from which it can still brake in the remaining discrete steps.
            step = acceleration * dt
            wanted = min(
                wanted, math.sqrt(step * step / 4 + 2 * acceleration * abs(left)) - step / 2
            )
        if dt > 0:
            wanted = min(wanted, abs(left) / dt)
        self.velocity = self._towards(math.copysign(wanted, left), dt)
        advance = self.velocity * dt
        slow = acceleration is None or abs(self.velocity) <= 2 * acceleration * dt
        if slow and abs(advance) >= abs(left) * (1 - 1e-9) and advance * left >= 0:
            self.position, self.velocity = target, 0.0
        else:
            self.position += advance
        return self.position

    def _towards(self, wanted: float, dt: float) -> float:
        if self._acceleration is None:
            return wanted
        step = self._acceleration * dt
        return self.velocity + clamp(wanted - self.velocity, -step, step)
