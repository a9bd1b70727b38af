"""The battery: charge drawn by the motors, and a voltage that sags with the current."""

from __future__ import annotations

from itertools import pairwise

__all__ = ["Battery"]

_CELLS = 3
_INNER = 0.015  # ohm
_IDLE, _HOVER = 0.6, 18.0  # A
_CURVE = ((0.0, 3.2), (0.1, 3.55), (0.3, 3.7), (0.6, 3.85), (1.0, 4.2))


class Battery:
    """A lithium pack of three cells."""

    def __init__(self, capacity: float, charge: float) -> None:
        self.capacity = capacity  # mAh
        self.charge = charge  # 0…1
        self.current = _IDLE  # A
        self.consumed = 0.0  # mAh

    @property
    def voltage(self) -> float:
        """Terminal voltage, V."""
        return _CELLS * _cell(self.charge) - self.current * _INNER

    def step(self, dt: float, throttle: float, *, armed: bool) -> None:
        """Discharge for `dt` seconds."""
        self.current = _IDLE + (_HOVER * (throttle / 0.43) ** 1.5 if armed else 0.0)
        used = self.current * dt / 3.6
        self.consumed += used
        self.charge = max(0.0, self.charge - used / self.capacity)


def _cell(charge: float) -> float:
    for (low, volts), (high, more) in pairwise(_CURVE):
        if charge <= high:
            return volts + (more - volts) * (charge - low) / (high - low)
    return _CURVE[-1][1]
