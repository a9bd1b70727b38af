"""What every body has: where it is, how it lies, how it moves. Axes are north, east, down; rad."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

__all__ = ["GRAVITY", "Body", "wrap"]

GRAVITY = 9.80665  # m/s2


class Body(ABC):
    """A body; what it should do is set in its `want_…`, `step` lets time pass."""

    def __init__(self) -> None:
        self.n = self.e = self.d = 0.0
        """Position, m from the place where it was put; `d` is 0 on the floor."""
        self.vn = self.ve = self.vd = 0.0  # m/s
        self.roll = self.pitch = self.yaw = 0.0
        self.p = self.q = self.r = 0.0
        """Rates of the body, rad/s."""
        self.an = self.ae = self.ad = 0.0
        """Acceleration, m/s2, gravity included: 0 at rest."""
        self.wind_n = self.wind_e = 0.0  # m/s, where it blows to
        self.landed = True
        self.impact = 0.0
        """Speed of the last touchdown, m/s."""

    @property
    @abstractmethod
    def throttle(self) -> float:
        """The part of the power in use, 0…1."""

    @abstractmethod
    def pulses(self, *, armed: bool) -> list[int]:
        """Return what its servos and motors are told, µs, in ArduPilot's order."""

    @abstractmethod
    def cut_power(self) -> None:
        """Have its motors give nothing for the next step."""

    @abstractmethod
    def step(self, dt: float) -> None:
        """Let `dt` seconds pass."""


def wrap(angle: float) -> float:
    """Return an angle between -π and π."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
