"""The torque that holds a joint against gravity, by its position."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

__all__ = ["Gravity"]


class Gravity:
    """A table of positions (rad) and torques (N·m) at the joint, linear between them."""

    def __init__(self, table: Sequence[tuple[float, float]]) -> None:
        self._positions = [position for position, _ in table]
        self._torques = [torque for _, torque in table]

    def torque(self, position: float) -> float:
        """Return the torque at a position; outside the table, that of its nearest end."""
        after = bisect_right(self._positions, position)
        if after == 0:
            return self._torques[0]
        if after == len(self._positions):
            return self._torques[-1]
        low, high = self._positions[after - 1 : after + 1]
        part = (position - low) / (high - low)
        return self._torques[after - 1] + part * (self._torques[after] - self._torques[after - 1])
