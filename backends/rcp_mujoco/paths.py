"""Timed paths in joint space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from rcp_kernel.errors import InvalidValue

__all__ = ["Path", "Quintic", "Spline", "Waypoint"]

_PEAK_SPEED = 1.875  # peak speed of a quintic, in distance per duration
_PEAK_ACCELERATION = 5.774  # peak acceleration of a quintic, in distance per duration squared
_LOOKS = 10  # at the speed, in each segment
_ROUNDING = 1.02
_SHORTEST = 0.02  # s


class Path(Protocol):
    """Positions of joints over time."""

    duration: float
    """s."""
    goal: Any
    """Positions at the end."""

    def at(self, seconds: float) -> Any:
        """Return the positions at a time in seconds after the start; at the end, those of the goal."""
        ...


class Quintic:
    """A straight line that starts and ends at rest."""

    def __init__(
        self, start: Any, goal: Any, *, speed: float, acceleration: float, least: float = 0.0
    ) -> None:
        """Plan with the maximum speed and acceleration of any joint, and a minimum duration, s."""
        self._start, self.goal = start, goal
        distance = float(np.abs(goal - start).max())
        self.duration = max(
            _SHORTEST,
            least,
            _PEAK_SPEED * distance / speed,
            (_PEAK_ACCELERATION * distance / acceleration) ** 0.5,
        )

    def at(self, seconds: float) -> Any:
        """Return the positions so many seconds after the start."""
        part = min(1.0, max(0.0, seconds / self.duration))
        shape = part**3 * (10 - 15 * part + 6 * part**2)
        return self._start + (self.goal - self._start) * shape


class Waypoint(NamedTuple):
    """Positions of all joints at a time."""

    time: float
    positions: Any
    velocities: Any | None
    """None: computed from the neighbours."""


class Spline:
    """Cubic segments through waypoints, at rest at the end.

    :raises InvalidValue: the times do not increase, or a joint would be too fast.
    """

    def __init__(
        self, start: Any, points: Sequence[Waypoint], *, speed: float, names: Sequence[str]
    ) -> None:
        points = [Waypoint(0.0, start, np.zeros_like(start)), *points]
        self._times = np.array([point.time for point in points])
        if not (np.diff(self._times) > 0).all():
            raise InvalidValue(
                "the times of the waypoints do not increase from a first one after 0",
                details={"pointer": "/points"},
            )
        self._positions = np.array([point.positions for point in points])
        self._velocities = self._slopes(points)
        self.duration = float(self._times[-1])
        self.goal = self._positions[-1]
        self._check(speed, names)

    def _slopes(self, points: Sequence[Waypoint]) -> Any:
        times, positions = self._times, self._positions
        velocities = np.zeros_like(positions)
        velocities[1:-1] = (positions[2:] - positions[:-2]) / (times[2:] - times[:-2])[:, None]
        for index, point in enumerate(points):
            if point.velocities is not None:
                velocities[index] = point.velocities
        velocities[-1] = 0.0
        return velocities

    def _check(self, speed: float, names: Sequence[str]) -> None:
        for segment in range(len(self._times) - 1):
            moments = np.linspace(self._times[segment], self._times[segment + 1], _LOOKS)
            places = np.array([self.at(moment) for moment in moments])
            fastest = (np.abs(np.diff(places, axis=0)) / np.diff(moments)[:, None]).max(axis=0)
            joint = int(fastest.argmax())
            if not fastest[joint] <= speed * _ROUNDING:  # an overflow gives no number
                raise InvalidValue(
                    f"waypoint {segment} needs {names[joint]} to move at {fastest[joint]:.2f} "
                    f"rad/s; its limit is {speed:g} rad/s",
                    details={"pointer": f"/points/{segment}"},
                    remedy="Allow more time between the waypoints.",
                )

    def at(self, seconds: float) -> Any:
        """Return the positions so many seconds after the start."""
        if seconds >= self.duration:
            return self.goal
        last = len(self._times) - 2
        segment = min(last, int(np.searchsorted(self._times, max(0.0, seconds), "right")) - 1)
        length = self._times[segment + 1] - self._times[segment]
        u = (max(0.0, seconds) - self._times[segment]) / length
        p, q = self._positions[segment], self._positions[segment + 1]
        v, w = self._velocities[segment] * length, self._velocities[segment + 1] * length
        return (
            (2 * u**3 - 3 * u**2 + 1) * p
            + (u**3 - 2 * u**2 + u) * v
            + (3 * u**2 - 2 * u**3) * q
            + (u**3 - u**2) * w
        )
