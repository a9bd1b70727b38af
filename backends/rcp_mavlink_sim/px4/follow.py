"""What a copter with PX4 follows: only FOLLOW_TARGET, whose height and attitude it ignores."""

from __future__ import annotations

import math
from typing import Any

from rcp_mavlink_sim.follow import Leader

__all__ = ["Px4Leader"]

_SLOW = 0.5  # m/s below which a target keeps the direction that it had


class Px4Leader(Leader):
    """The target of one vehicle, at a height above home (FLW_TGT_ALT_M 0)."""

    def _height(self, above_home: float) -> float:
        return 0.0

    def _facing(self, message: Any, north: float, east: float) -> float | None:
        return math.atan2(east, north) if math.hypot(north, east) > _SLOW else self._heading
