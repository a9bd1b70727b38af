"""Cubic curves through points in time, and their extreme positions and velocities."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

__all__ = ["Cubic", "Knot", "Sample"]


class Knot(NamedTuple):
    """A point of a curve; without a velocity, it is chosen for a continuous acceleration."""

    time: float
    position: float
    velocity: float | None = None


class Sample(NamedTuple):
    """A curve at a moment."""

    position: float
    velocity: float
    acceleration: float


class _Segment(NamedTuple):
    """`a + b t + c t² + d t³`, from its start."""

    duration: float
    a: float
    b: float
    c: float
    d: float

    def at(self, t: float) -> Sample:
        return Sample(
            self.a + t * (self.b + t * (self.c + t * self.d)),
            self.b + t * (2 * self.c + 3 * t * self.d),
            2 * self.c + 6 * t * self.d,
        )

    def turns(self) -> list[float]:
        """Return the times of possible extremes of position or velocity."""
        moments = [0.0, self.duration]
        if self.d:
            moments.append(-self.c / (3 * self.d))
            root = self.c * self.c - 3 * self.d * self.b
            if root >= 0:
                # Without cancellation of digits if `d` is small.
                q = -(self.c + math.copysign(math.sqrt(root), self.c))
                moments.append(q / (3 * self.d))
                if q:
                    moments.append(self.b / q)
        elif self.c:
            moments.append(-self.b / (2 * self.c))
        return [moment for moment in moments if 0.0 <= moment <= self.duration]


class Cubic:
    """A curve through two knots or more; the first and the last have a velocity."""

    def __init__(self, knots: Sequence[Knot]) -> None:
        velocities = _velocities(knots)
        self._times = [knot.time for knot in knots]
        self._segments = [
            _segment(before, after, velocities[number], velocities[number + 1])
            for number, (before, after) in enumerate(pairwise(knots))
        ]

    def at(self, time: float) -> Sample:
        """Return the curve at a time between its start and end."""
        number = min(bisect_right(self._times, time) - 1, len(self._segments) - 1)
        return self._segments[max(number, 0)].at(time - self._times[max(number, 0)])

    def extremes(self, segment: int) -> list[Sample]:
        """Return the samples of a segment that include all its extremes."""
        found = self._segments[segment]
        return [found.at(moment) for moment in found.turns()]

    @property
    def segments(self) -> int:
        """The number of segments: one less than knots."""
        return len(self._segments)


def _segment(before: Knot, after: Knot, v0: float, v1: float) -> _Segment:
    duration = after.time - before.time
    mean = (after.position - before.position) / duration
    c = (3 * mean - 2 * v0 - v1) / duration
    d = (v0 + v1 - 2 * mean) / duration**2
    return _Segment(duration, before.position, v0, c, d)


def _velocities(knots: Sequence[Knot]) -> list[float]:
    """Fill in missing velocities for a continuous acceleration.

    The system is tridiagonal and diagonally dominant, so elimination needs no pivoting.
    """
    over: list[float] = []
    right: list[float] = []
    for number, knot in enumerate(knots):
        if knot.velocity is not None:
            over.append(0.0)
            right.append(knot.velocity)
            continue
        before, after = knots[number - 1], knots[number + 1]
        h0, h1 = knot.time - before.time, after.time - knot.time
        rise = (knot.position - before.position) / h0 * h1 / h0
        rise += (after.position - knot.position) / h1
        under, middle, upper = h1 / h0, 2 * (1 + h1 / h0), 1.0
        pivot = middle - under * over[-1]
        over.append(upper / pivot)
        right.append((3 * rise - under * right[-1]) / pivot)
    for number in range(len(knots) - 2, -1, -1):
        right[number] -= over[number] * right[number + 1]
    return right
