"""A sine of changing frequency that begins and ends gently, with bounds on its derivatives."""

from __future__ import annotations

import math

__all__ = ["ChirpSignal"]

_TURN = 2 * math.pi
_GENTLE = 4  # at most this part of the duration at either end


class ChirpSignal:
    """A signal between -1 and 1 that is zero at both ends; frequencies in Hz, times in s."""

    def __init__(self, start: float, end: float, duration: float) -> None:
        self._start, self.duration = start, duration
        self._sweep = (end - start) / duration
        self.lowest, self._highest = min(start, end), max(start, end)
        self._fade = min(1 / self.lowest, duration / _GENTLE)

    @property
    def slope(self) -> float:
        """A bound of its first derivative, 1/s."""
        return _TURN * self._highest + math.pi / 2 / self._fade

    @property
    def curvature(self) -> float:
        """A bound of its second derivative, 1/s²."""
        fade = math.pi / 2 / self._fade
        steep = _TURN * self._highest
        bend = math.pi**2 / 2 / self._fade**2
        return steep**2 + _TURN * abs(self._sweep) + 2 * fade * steep + bend

    @property
    def integral(self) -> float:
        """A bound of its integral from the start, s."""
        return 2 / (math.pi * self.lowest)

    def at(self, time: float) -> tuple[float, float]:
        """Return value and first derivative."""
        if not 0 <= time <= self.duration:
            return 0.0, 0.0
        angle = _TURN * (self._start * time + self._sweep * time * time / 2)
        turning = _TURN * (self._start + self._sweep * time)
        size, growth = self._envelope(time)
        sine, cosine = math.sin(angle), math.cos(angle)
        return size * sine, growth * sine + size * turning * cosine

    def _envelope(self, time: float) -> tuple[float, float]:
        """Return a raised cosine at both ends, and its derivative."""
        left = min(time, self.duration - time)
        if left >= self._fade:
            return 1.0, 0.0
        angle = math.pi * left / self._fade
        growth = math.pi / 2 / self._fade * math.sin(angle)
        return (1 - math.cos(angle)) / 2, growth if time < self.duration / 2 else -growth
