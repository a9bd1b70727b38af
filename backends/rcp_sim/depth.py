"""A forward depth camera: floor, walls and boxes as coloured points in its frame.

The floor points of a column are always the same up to the wall, so they are computed once.
"""

from __future__ import annotations

import math
import random
import struct
import sys
from array import array
from bisect import bisect_left, bisect_right

from rcp_sim.camera import EYE, TALL, TONES
from rcp_sim.raycast import Fan
from rcp_sim.simulation import Simulation
from rcp_sim.spatial import PointCloud, PointField, stamped

__all__ = ["COLUMNS", "REACH", "ROWS", "Depth"]

COLUMNS, ROWS = 80, 50
REACH = 12.0  # m
_STEP = 16  # bytes per point
_FOCUS = COLUMNS / 2 / math.tan(math.radians(35))  # columns, 70 degrees wide
_FLOOR = (120, 114, 108)
_FAN = Fan([math.atan((column - COLUMNS / 2 + 0.5) / _FOCUS) for column in range(COLUMNS)])
_TANGENTS = [math.tan(angle) for angle in _FAN.angles]
_COSINES = [math.cos(angle) for angle in _FAN.angles]
_SLOPES = [(row - ROWS / 2 + 0.5) / _FOCUS for row in range(ROWS)]
"""Slope (up per metre ahead) of each row, lowest first."""
_AHEAD = [EYE / -slope for slope in _SLOPES if slope < 0 and EYE / -slope < REACH]
"""Distance at which each row meets the floor, nearest first, m."""
_FIELDS = [PointField(name, 4 * at) for at, name in enumerate(("x", "y", "z", "rgb"))]


def _packed(colour: tuple[int, int, int]) -> float:
    """Return the colour as a packed number, as PCL encodes it."""
    red, green, blue = colour
    (number,) = struct.unpack("=f", struct.pack("=I", red << 16 | green << 8 | blue))
    return number


_COLOURS = [_packed(tone) for tone in TONES]
_FLOORS = [
    b"".join(struct.pack("=4f", ahead, ahead * tangent, -EYE, _packed(_FLOOR)) for ahead in _AHEAD)
    for tangent in _TANGENTS
]


class Depth:
    """Generates point clouds, with its own noise."""

    def __init__(self, seed: int, noise: float) -> None:
        draw = random.Random(f"{seed} depth")  # noqa: S311 - a simulation, not a secret
        self._ripple = [1 + draw.gauss(0, 0.003) * noise for _ in range(COLUMNS + 256)]
        self._draw = draw

    def cloud(self, sim: Simulation, now: int) -> PointCloud:
        """Return the point cloud ahead of the rover."""
        rover, faces = sim.rover, sim.world.faces
        ranges, hits = _FAN.cast(faces, rover.x, rover.y, rover.yaw, REACH / _COSINES[0])
        start = self._draw.randrange(256)
        parts: list[bytes] = []
        for column, (distance, hit) in enumerate(zip(ranges, hits, strict=True)):
            ahead = distance * _COSINES[column] if hit >= 0 else math.inf
            parts.append(_FLOORS[column][: _STEP * bisect_left(_AHEAD, ahead)])
            if ahead < REACH:
                tone = faces[hit].tone
                parts.append(_wall(ahead * self._ripple[start + column], column, tone))
        data = b"".join(parts)
        count = len(data) // _STEP
        return PointCloud(
            stamped("camera", now),
            1,
            count,
            _FIELDS,
            sys.byteorder == "big",
            _STEP,
            len(data),
            data,
        )


def _wall(ahead: float, column: int, tone: int) -> bytes:
    """Return the points on the face that a column sees above the floor."""
    low = bisect_right(_SLOPES, -EYE / ahead)
    high = bisect_left(_SLOPES, (TALL[tone >= 2] - EYE) / ahead)
    y, colour = ahead * _TANGENTS[column], _COLOURS[tone]
    flat = array("f")
    for slope in _SLOPES[low:high]:
        flat.extend((ahead, y, slope * ahead, colour))
    return flat.tobytes()
