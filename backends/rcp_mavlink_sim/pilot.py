"""What every controller is told: a place, a velocity or an attitude to have."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

__all__ = ["Limits", "Pilot", "clip", "pace"]


class Limits:
    """How fast it goes, from the parameters of the vehicle."""

    def __init__(self) -> None:
        self.speed = 10.0  # m/s
        self.up = 2.5  # m/s
        self.down = 1.5  # m/s
        self.acceleration = 2.5  # m/s2
        self.climb_acceleration = 1.5  # m/s2


class Pilot(ABC):
    """Steers a body; north, east and down are each led by a place or by a velocity."""

    def __init__(self, body: Any) -> None:
        self.body = body
        self.limits = Limits()
        self.place: tuple[float, float] | None = (0.0, 0.0)
        """North and east to be at, m; None follows `velocity`."""
        self.velocity = (0.0, 0.0)
        """North and east, m/s; with a place it is where that place moves to."""
        self.depth: float | None = None
        """Down to be at, m; None follows `sinking`."""
        self.sinking = 0.0  # m/s, down
        self.yaw = 0.0
        self.yaw_rate = 0.0  # rad/s, lets `yaw` run
        self.faces_travel = False
        """A copter looks where it goes to, and `yaw` follows."""
        self.attitude: tuple[float, float, float] | None = None
        """Roll, pitch (rad) and thrust (0…1, half is hovering) that rule instead of all else."""
        self.lean: tuple[float, float] | None = None
        """Roll and pitch (rad) that rule instead of place and velocity."""
        self.passes = False
        """A wing goes straight at the place, and not round it."""
        self.spinning = False

    def hold(self) -> None:
        """Stay where it would come to rest if it braked now."""
        body, limits = self.body, self.limits
        speed = math.hypot(body.vn, body.ve)
        way = speed / (2 * limits.acceleration) + 0.4
        self.place = (body.n + body.vn * way, body.e + body.ve * way)
        self.velocity = (0.0, 0.0)
        self.depth = body.d + body.vd * 0.5
        self.sinking = self.yaw_rate = 0.0
        self.attitude = self.lean = None
        self.faces_travel = False

    def at_place(self, tolerance: float) -> bool:
        """Tell whether it is where it should be, within `tolerance` m."""
        body = self.body
        if self.place is None or self.depth is None:
            return False
        n, e = self.place
        return math.dist((body.n, body.e, body.d), (n, e, self.depth)) <= tolerance

    def away(self) -> float:
        """Return how far the place to be at is, m over ground."""
        if self.place is None:
            return 0.0
        return math.dist((self.body.n, self.body.e), self.place)

    def reset(self) -> None:
        """Begin from rest, as after arming."""
        self.yaw, self.yaw_rate, self.attitude = self.body.yaw, 0.0, None
        self.faces_travel = False

    @abstractmethod
    def step(self, dt: float) -> None:
        """Say what the body should do for the next `dt` seconds."""


def pace(way: float, fastest: float, acceleration: float, gain: float = 1.0) -> float:
    """Return the speed at which `way` m are still enough to brake in."""
    linear = acceleration / (gain * gain)
    if way <= linear:
        return min(fastest, gain * way)
    return min(fastest, math.sqrt(2 * acceleration * (way - linear / 2)))


def clip(value: float, most: float) -> float:
    """Return a value between `-most` and `most`."""
    return min(most, max(-most, value))
