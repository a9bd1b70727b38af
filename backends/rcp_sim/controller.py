"""The path follower of the rover: turn, drive, brake, align."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Literal

from rcp_sim.messages import TOP_TURN
from rcp_sim.rover import BRAKE, TURN_ACCEL, Rover, wrapped

__all__ = ["Follower", "Phase"]

Phase = Literal["turning", "driving", "aligning", "braking", "done"]

_CARE = 0.6  # fraction of the maximum deceleration used for planning
_FACING = 0.04  # rad, heading error below which it drives off
_ASTRAY = 0.4  # rad, heading error above which it stops and turns
_CORNER = 0.06  # m, tolerance at a point of the path
_ALIGNED = 0.02  # rad, tolerance of the final heading
_PATIENCE = 30.0  # s without progress before it gives up


class Follower:
    """Follows `way` (points on the map, the goal last) and reports its progress."""

    def __init__(
        self,
        path: list[tuple[float, float]],
        *,
        tolerance: float,
        yaw: float | None = None,
        speed: float = math.inf,
    ) -> None:
        self._path = path
        self._tolerance = tolerance
        self._yaw = yaw
        self.speed = speed
        """Maximum speed, m/s."""
        self._still = 0.0
        self._best = math.inf
        self.phase: Phase = "turning"

    @property
    def goal(self) -> tuple[float, float]:
        """The last point of the path."""
        return self._path[-1]

    @property
    def path(self) -> list[tuple[float, float]]:
        """The points still ahead."""
        return self._path

    @property
    def stuck(self) -> bool:
        """Whether it has made no progress for a long time."""
        return self._still > _PATIENCE

    def reroute(self, path: list[tuple[float, float]]) -> None:
        """Take another path to the same goal."""
        self._path = path
        self.phase = "turning"
        self._best = math.inf

    def remaining(self, rover: Rover) -> float:
        """Return the remaining distance, m."""
        points = [(rover.x, rover.y), *self._path]
        return sum(math.dist(a, b) for a, b in pairwise(points))

    def command(self, rover: Rover, limit: float, dt: float) -> tuple[float, float]:
        """Return the linear and angular velocity for the next `dt` seconds; both 0 once done."""
        self._watch(rover, limit, dt)
        if self.phase == "done":
            return 0.0, 0.0
        if self.phase == "aligning":
            return self._align(rover)
        x, y = self._path[0]
        distance = math.hypot(x - rover.x, y - rover.y)
        if len(self._path) > 1 and distance < _CORNER:
            del self._path[0]
            self.phase = "turning"
            return self.command(rover, limit, 0.0)
        if len(self._path) == 1 and distance < self._tolerance * 0.8:
            return self._arrive(rover)
        return self._drive(rover, distance, math.atan2(y - rover.y, x - rover.x), limit)

    def _drive(
        self, rover: Rover, distance: float, bearing: float, limit: float
    ) -> tuple[float, float]:
        off = wrapped(bearing - rover.yaw)
        if self.phase != "driving" and abs(off) < _FACING:
            self.phase = "driving"
        elif abs(off) > _ASTRAY:
            self.phase = "turning"
        if self.phase != "driving" or limit == 0:
            return 0.0, _turn(off) if limit else 0.0
        short = 0.0 if len(self._path) > 1 else self._tolerance / 2
        v = math.sqrt(2 * _CARE * BRAKE * max(0.0, distance - short))
        crawl = 0.02  # m/s: keeps a minimum speed for the last centimetres
        return min(limit, self.speed, max(crawl, v)), _turn(off)

    def _arrive(self, rover: Rover) -> tuple[float, float]:
        self.phase = "braking"
        if rover.at_rest:
            self.phase = "done" if self._yaw is None else "aligning"
        return 0.0, 0.0

    def _align(self, rover: Rover) -> tuple[float, float]:
        off = wrapped((self._yaw or 0.0) - rover.yaw)
        if abs(off) > _ALIGNED:
            return 0.0, _turn(off)
        if rover.at_rest:
            self.phase = "done"
        return 0.0, 0.0

    def _watch(self, rover: Rover, limit: float, dt: float) -> None:
        """Count the time without progress; waiting under a speed limit of 0 does not count."""
        left = self.remaining(rover) + abs(rover.w)
        if left < self._best - 0.01 or limit == 0 or self.phase == "aligning":
            self._best = min(self._best, left)
            self._still = 0.0
        else:
            self._still += dt


def _turn(off: float) -> float:
    """Return the turning rate that removes a heading error without overshoot."""
    rate = min(TOP_TURN, 4 * abs(off), math.sqrt(2 * _CARE * TURN_ACCEL * abs(off)))
    return math.copysign(rate, off)
