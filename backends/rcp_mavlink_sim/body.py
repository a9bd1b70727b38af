"""State common to all bodies: position, attitude, velocity. Axes are north, east, down; rad."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

__all__ = ["GRAVITY", "Body", "wrap"]

GRAVITY = 9.80665  # m/s2


class Body(ABC):
    """A body; set its demands in `want_…`, then `step` advances time."""

    def __init__(self) -> None:
        self.n = self.e = self.d = 0.0
        """Position relative to the start, m; `d` is 0 on the ground."""
        self.vn = self.ve = self.vd = 0.0  # m/s
        self.roll = self.pitch = self.yaw = 0.0
        self.p = self.q = self.r = 0.0
        """Body rates, rad/s."""
        self.an = self.ae = self.ad = 0.0
        """Acceleration, m/s2, including gravity: 0 at rest."""
        self.wind_n = self.wind_e = 0.0  # m/s, direction it blows towards
        self.landed = True
        self.impact = 0.0
        """Vertical speed of the last touchdown, m/s."""

    @property
    @abstractmethod
    def throttle(self) -> float:
        """Fraction of the power in use, 0…1."""

    @abstractmethod
    def pulses(self, *, armed: bool) -> list[int]:
        """Return the servo and motor outputs, µs, in ArduPilot's order."""

    @abstractmethod
    def cut_power(self) -> None:
        """Disable the motors for the next step."""

    @abstractmethod
    def step(self, dt: float) -> None:
        """Advance by `dt` seconds."""


def wrap(angle: float) -> float:
    """Wrap an angle to -π…π."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
