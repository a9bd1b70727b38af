"""Control of a differential drive towards a goal: turn towards it, drive, turn to the heading."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from rcp_can.codec import clamp
from rcp_can.odometry import Place, wrapped

__all__ = ["Goal", "GoalControl", "Phase"]

Phase = Literal["turning", "driving", "aligning", "done"]
_AIMED = 0.03  # rad of bearing error below which it drives on
_ASTRAY = 0.5  # rad of bearing error at which it turns on the spot again
_STEERING = 2.0  # rad/s of yaw rate per rad of bearing error
_RESERVE = 0.6  # fraction of the deceleration that the plan uses
_GENTLER = 0.25  # of the deceleration, in a further attempt: half as fast at the same distance
_CREEP, _CREEP_TURN = 0.02, 0.04  # m/s and rad/s: below these it would stick


class Goal(NamedTuple):
    """The goal and its tolerances; m and rad."""

    x: float
    y: float
    heading: float | None
    tolerance: float
    heading_tolerance: float


class GoalControl:
    """Velocities for each measured place, within the limits."""

    def __init__(
        self, goal: Goal, *, turn_rate: float, acceleration: float, turn_acceleration: float
    ) -> None:
        self._goal, self._turn_rate = goal, turn_rate
        self._acceleration, self._turn_acceleration = acceleration, turn_acceleration
        self.phase: Phase = "turning"

    def distance(self, place: Place) -> float:
        """Return the distance to the goal, m."""
        return math.hypot(self._goal.x - place.x, self._goal.y - place.y)

    def remaining(self, place: Place) -> float:
        """Return what is left of the present phase: m while driving, otherwise rad."""
        if self.phase == "driving":
            return self.distance(place)
        heading = self._goal.heading if self.phase == "aligning" else None
        return abs(self._off(place) if heading is None else wrapped(heading - place.heading))

    def reached(self, place: Place) -> bool:
        """Return whether a place is the goal, within the tolerances."""
        heading = self._goal.heading
        aligned = heading is None or (
            abs(wrapped(heading - place.heading)) <= self._goal.heading_tolerance
        )
        return aligned and self.distance(place) <= self._goal.tolerance

    def again(self, place: Place) -> None:
        """Restart from a place, and brake earlier: what it overshot by, late feedback made it."""
        self._acceleration *= _GENTLER
        self._turn_acceleration *= _GENTLER
        near = self.distance(place) <= self._goal.tolerance
        self.phase = "aligning" if near else "turning"

    def step(self, place: Place, speed: float) -> tuple[float, float]:
        """Return the speed, at most `speed`, and the yaw rate from a place."""
        if self.phase == "turning":
            off = self._off(place)
            if self.distance(place) <= self._goal.tolerance / 2:
                self.phase = "aligning"
            elif abs(off) > _AIMED:
                return 0.0, self._turn(off)
            else:
                self.phase = "driving"
        if self.phase == "driving" and (driven := self._drive(place, speed)) is not None:
            return driven
        if self.phase == "aligning":
            heading = self._goal.heading
            off = 0.0 if heading is None else wrapped(heading - place.heading)
            if abs(off) > self._goal.heading_tolerance / 2:
                return 0.0, self._turn(off)
            self.phase = "done"
        return 0.0, 0.0

    def _drive(self, place: Place, speed: float) -> tuple[float, float] | None:
        distance, off = self.distance(place), self._off(place)
        ahead = distance * math.cos(off)
        astray = abs(off) > _ASTRAY
        # Beside a near goal it would circle around it, because the heading is late.
        there = distance <= self._goal.tolerance / (1 if astray else 2)
        if there or ahead <= 0:
            self.phase = "aligning"
            return None
        if astray:
            self.phase = "turning"
            return 0.0, self._turn(off)
        brake = math.sqrt(2 * _RESERVE * self._acceleration * ahead)
        near = min(1.0, distance / (3 * self._goal.tolerance))  # the bearing swings near the goal
        turn = clamp(_STEERING * off * near, -self._turn_rate, self._turn_rate)
        return min(speed, max(brake, _CREEP)), turn if speed else 0.0

    def _off(self, place: Place) -> float:
        goal = self._goal
        return wrapped(math.atan2(goal.y - place.y, goal.x - place.x) - place.heading)

    def _turn(self, off: float) -> float:
        brake = math.sqrt(2 * _RESERVE * self._turn_acceleration * abs(off))
        return math.copysign(min(self._turn_rate, max(brake, _CREEP_TURN)), off)

    def time_left(self, place: Place, speed: float) -> float | None:
        """Estimate the time to the goal, s; None if the speed limit is zero."""
        goal, distance = self._goal, self.distance(place)
        if not speed:
            return None
        total, heading = 0.0, place.heading
        if self.phase in ("turning", "driving") and distance > goal.tolerance / 2:
            if self.phase == "turning":
                total += _time(abs(self._off(place)), self._turn_rate, self._turn_acceleration)
            total += _time(distance, speed, _RESERVE * self._acceleration)
            heading = math.atan2(goal.y - place.y, goal.x - place.x)
        if goal.heading is not None and self.phase != "done":
            off = abs(wrapped(goal.heading - heading))
            total += _time(off, self._turn_rate, self._turn_acceleration)
        return total


def _time(way: float, speed: float, acceleration: float) -> float:
    """Return the duration of a trapezoidal profile."""
    if way > speed * speed / acceleration:
        return way / speed + speed / acceleration
    return 2 * math.sqrt(way / acceleration)
