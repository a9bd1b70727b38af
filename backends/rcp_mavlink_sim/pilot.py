"""The interface of all controllers: a target position, velocity or attitude."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

__all__ = ["Limits", "Pilot", "clip", "pace"]


class Limits:
    """Maximum speeds and accelerations, from the vehicle's parameters."""

    def __init__(self) -> None:
        self.speed = 10.0  # m/s
        self.up = 2.5  # m/s
        self.down = 1.5  # m/s
        self.acceleration = 2.5  # m/s2
        self.climb_acceleration = 1.5  # m/s2


class Pilot(ABC):
    """Controls a body; the horizontal and vertical axes each follow a position or a velocity."""

    def __init__(self, body: Any) -> None:
        self.body = body
        self.limits = Limits()
        self.place: tuple[float, float] | None = (0.0, 0.0)
        """North and east target, m; None follows `velocity`."""
        self.velocity = (0.0, 0.0)
        """North and east, m/s; with a target it is the velocity of the target."""
        self.depth: float | None = None
        """Down target, m; None follows `sinking`."""
        self.sinking = 0.0  # m/s, down
        self.yaw = 0.0
        self.yaw_rate = 0.0  # rad/s, changes `yaw`
        self.faces_travel = False
        """Whether a copter faces its direction of travel, and `yaw` follows."""
        self.attitude: tuple[float, float, float] | None = None
        """Roll, pitch (rad) and thrust (0…1, half is hovering) that override everything else."""
        self.lean: tuple[float, float] | None = None
        """Roll and pitch (rad) that override position and velocity."""
        self.most: float | None = None
        """Limit of the whole horizontal speed, that of a target included, m/s; None if there is none."""
        self.passes = False
        """Whether a plane flies straight at the target instead of circling it."""
        self.spinning = False

    def hold(self) -> None:
        """Hold the point where it would come to rest if it braked now."""
        body, limits = self.body, self.limits
        speed = math.hypot(body.vn, body.ve)
        distance = speed / (2 * limits.acceleration) + 0.4
        self.place = (body.n + body.vn * distance, body.e + body.ve * distance)
        self.velocity = (0.0, 0.0)
        self.depth = body.d + body.vd * 0.5
        self.sinking = self.yaw_rate = 0.0
        self.attitude = self.lean = None
        self.faces_travel = False

    def at_place(self, tolerance: float) -> bool:
        """Return whether it is at its target, within `tolerance` m."""
        body = self.body
        if self.place is None or self.depth is None:
            return False
        n, e = self.place
        return math.dist((body.n, body.e, body.d), (n, e, self.depth)) <= tolerance

    def away(self) -> float:
        """Return the horizontal distance to the target, m."""
        if self.place is None:
            return 0.0
        return math.dist((self.body.n, self.body.e), self.place)

    def reset(self) -> None:
        """Start from rest, as after arming."""
        self.yaw, self.yaw_rate, self.attitude = self.body.yaw, 0.0, None
        self.faces_travel = False

    @abstractmethod
    def step(self, dt: float) -> None:
        """Set the demands of the body for the next `dt` seconds."""


def pace(distance: float, fastest: float, acceleration: float, gain: float = 1.0) -> float:
    """Return the maximum speed from which it can brake within `way` m."""
    linear = acceleration / (gain * gain)
    if distance <= linear:
        return min(fastest, gain * distance)
    return min(fastest, math.sqrt(2 * acceleration * (distance - linear / 2)))


def clip(value: float, most: float) -> float:
    """Limit a value to ±`most`."""
    return min(most, max(-most, value))
