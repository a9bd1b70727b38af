"""Synchronized straight-line moves of several joints: one trapezoidal profile that all share."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

from rcp_can.pace import Pace

__all__ = ["Leg", "Path"]

_LATE = 0.1  # s: a longer gap counts as this, so that no joint jumps

_NOTHING = 1e-9  # rad: a joint closer to its goal than this does not move


class Leg(NamedTuple):
    """The motion of one joint; rad, rad/s and rad/s² at the joint."""

    start: float
    goal: float
    velocity: float
    acceleration: float

    @property
    def distance(self) -> float:
        """Signed distance, rad."""
        return self.goal - self.start


class Path:
    """A shared time scaling: all joints start, accelerate, brake and stop together.

    Each joint stays within its limits. Time advances as the joints query it: from one of its queries
    to the next, no joint goes on by more than `late` s.
    """

    def __init__(
        self, legs: Iterable[Leg], clock: Callable[[], float] = time.monotonic, late: float = _LATE
    ) -> None:
        moving = [leg for leg in legs if abs(leg.distance) > _NOTHING]
        speed = min((leg.velocity / abs(leg.distance) for leg in moving), default=math.inf)
        self._acceleration = min(
            (leg.acceleration / abs(leg.distance) for leg in moving), default=1.0
        )
        self._peak = min(speed, math.sqrt(self._acceleration))
        self._pace, self._late = Pace(late, clock), late
        self._members = itertools.count()
        self._elapsed = 0.0
        self._braked: tuple[float, float, float] | None = None
        self._planned = 1 / self._peak + self._peak / self._acceleration if moving else 0.0
        self.duration = self._planned
        """Duration in s; shorter once it is braked."""

    def follow(self, leg: Leg) -> Callable[[], tuple[float, float]]:
        """Return a function that gives the current position and velocity of one joint."""
        member, reached = next(self._members), 0.0

        def now() -> tuple[float, float]:
            nonlocal reached
            self._elapsed += self._pace.advance(member)
            # Several cycles of a faster joint may lie between two of this one.
            reached = min(self._elapsed, reached + self._late)
            part, speed = self._at(reached)
            return leg.start + leg.distance * part, leg.distance * speed

        return now

    @property
    def part(self) -> float:
        """The completed fraction."""
        return self._at(self._elapsed)[0]

    @property
    def over(self) -> bool:
        """Whether the move has ended, at the goal or braked."""
        return self._elapsed >= self.duration

    def brake(self) -> None:
        """Come to rest on the line, as early as the limits allow."""
        if self._braked is None and not self.over:
            part, speed = self._at(self._elapsed)
            self._braked = self._elapsed, part, speed
            self.duration = min(self.duration, self._elapsed + speed / self._acceleration)

    def _at(self, moment: float) -> tuple[float, float]:
        moment = min(moment, self.duration)
        acceleration = self._acceleration
        if self._braked is not None and moment >= self._braked[0]:
            since, part, speed = self._braked
            gone = moment - since
            return part + speed * gone - acceleration * gone * gone / 2, speed - acceleration * gone
        rise = self._peak / acceleration
        if moment < rise:
            return acceleration * moment * moment / 2, acceleration * moment
        left = self._planned - moment
        if left < rise:
            return 1 - acceleration * left * left / 2, acceleration * left
        return self._peak * (moment - rise / 2), self._peak
