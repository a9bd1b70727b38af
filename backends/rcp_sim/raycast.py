"""Ranges to the faces of a world along many rays at once.

Each face that points to the sensor is intersected only with the rays within its own angle, so the
cost grows with what is visible instead of rays times faces. 360 rays take about 0.2 ms.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence

from rcp_sim.world import Face

__all__ = ["Fan"]

_TURN = 2 * math.pi


class Fan:
    """Rays at fixed angles relative to the heading, ascending, within ±π."""

    def __init__(self, angles: Sequence[float]) -> None:
        self.angles = tuple(angles)

    def cast(
        self, faces: Sequence[Face], x: float, y: float, heading: float, reach: float
    ) -> tuple[list[float], list[int]]:
        """Return the distance to the nearest face, and its index, for each ray.

        If nothing is within `reach`, the distance is infinite and the index -1.
        """
        angles = self.angles
        ranges = [reach] * len(angles)
        hits = [-1] * len(angles)
        rays = ([math.sin(heading + a) for a in angles], [math.cos(heading + a) for a in angles])
        for index, face in enumerate(faces):
            gap = face.at - (x if face.upright else y)
            if gap * face.normal >= 0 or abs(gap) > reach:
                continue
            start, width = _span(face, gap, x, y)
            start = (start - heading + math.pi) % _TURN - math.pi
            along = rays[face.upright]
            for first in (start, start - _TURN):
                for ray in range(bisect_left(angles, first), bisect_right(angles, first + width)):
                    if along[ray] and 0 < (distance := gap / along[ray]) < ranges[ray]:
                        ranges[ray] = distance
                        hits[ray] = index
        return [r if h >= 0 else math.inf for r, h in zip(ranges, hits, strict=True)], hits


def _span(face: Face, gap: float, x: float, y: float) -> tuple[float, float]:
    """Return the bearing of the face's right end and the angle it covers to the left."""
    if face.upright:
        low, high = math.atan2(face.low - y, gap), math.atan2(face.high - y, gap)
        right, left = (low, high) if gap > 0 else (high, low)
    else:
        low, high = math.atan2(gap, face.low - x), math.atan2(gap, face.high - x)
        right, left = (high, low) if gap > 0 else (low, high)
    return right, (left - right) % _TURN
