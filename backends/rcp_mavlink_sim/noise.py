"""Sensor errors: white noise, and errors that drift slowly. Seeded."""

from __future__ import annotations

import math
from random import Random

__all__ = ["Noise"]

_PERIOD = 0.1  # s between steps of the drift
_LEAST_WANDER = 1e-9
_WANDERS = {
    "gps_n": (0.5, 30.0),
    "gps_e": (0.5, 30.0),
    "gps_d": (0.9, 30.0),
    "n": (0.12, 8.0),
    "e": (0.12, 8.0),
    "d": (0.1, 8.0),
    "vn": (0.03, 2.0),
    "ve": (0.03, 2.0),
    "vd": (0.03, 2.0),
    "roll": (0.003, 5.0),
    "pitch": (0.003, 5.0),
    "yaw": (0.01, 20.0),
    "baro": (0.02, 60.0),
}
"""Standard deviation and correlation time, s: m, m/s, rad, hPa."""


class Noise:
    """Errors of one vehicle; a scale of 0 disables them."""

    def __init__(self, seed: int, scale: float) -> None:
        self._random = Random(seed)  # noqa: S311 - a reproducible simulation
        self.scale = scale
        self._wandering = dict.fromkeys(_WANDERS, 0.0)
        self._left = 0.0

    def white(self, sigma: float) -> float:
        """Return an uncorrelated error."""
        return self._random.gauss(0.0, sigma * self.scale) if self.scale else 0.0

    def slow(self, name: str) -> float:
        """Return a correlated error, which changes slowly."""
        return self._wandering[name]

    def step(self, seconds: float) -> None:
        """Advance the slow errors."""
        if not self.scale:
            return
        self._left += seconds
        if self._left < _PERIOD:
            return
        for name, (sigma, lasts) in _WANDERS.items():
            kept = math.exp(-self._left / lasts)
            fresh = sigma * self.scale * math.sqrt(max(_LEAST_WANDER, 1 - kept * kept))
            self._wandering[name] = kept * self._wandering[name] + self._random.gauss(0.0, fresh)
        self._left = 0.0
