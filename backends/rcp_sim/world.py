"""The geometry of the world: a walled hall with boxes, and its occupancy grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from rcp_sim.messages import Box

__all__ = ["WAREHOUSE", "Face", "Rect", "World"]

FREE = b"\x00"
OCCUPIED = b"\x64"


class Rect(NamedTuple):
    """An axis-aligned rectangle, in metres."""

    left: float
    bottom: float
    right: float
    top: float

    @classmethod
    def of(cls, box: Box) -> Rect:
        """Return the outline of a box."""
        dx, dy = box.size_x / 2, box.size_y / 2
        return cls(box.x - dx, box.y - dy, box.x + dx, box.y + dy)

    def grown(self, by: float) -> Rect:
        """Return the rectangle with every side moved outwards (inwards if negative)."""
        return Rect(self.left - by, self.bottom - by, self.right + by, self.top + by)

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point is inside, excluding the border."""
        return self.left < x < self.right and self.bottom < y < self.top


class Face(NamedTuple):
    """One side of a wall or box, as the range finder and the camera see it."""

    upright: bool
    """Whether it lies at a constant x, otherwise at a constant y."""
    at: float
    low: float
    high: float
    normal: int
    """+1 if the free side is towards greater x (or y), otherwise -1."""
    tone: int
    """Index of its colour."""


def _faces(rect: Rect, side: int, tone: int) -> tuple[Face, ...]:
    return (
        Face(True, rect.left, rect.bottom, rect.top, -side, tone),
        Face(True, rect.right, rect.bottom, rect.top, side, tone),
        Face(False, rect.bottom, rect.left, rect.right, -side, tone + 1),
        Face(False, rect.top, rect.left, rect.right, side, tone + 1),
    )


class World:
    """A hall centred on the origin, with boxes; immutable."""

    def __init__(self, width: float, height: float, obstacles: Sequence[Rect] = ()) -> None:
        self.bounds = Rect(-width / 2, -height / 2, width / 2, height / 2)
        self.obstacles = tuple(obstacles)
        self.faces: tuple[Face, ...] = _faces(self.bounds, -1, 0)
        for number, rect in enumerate(self.obstacles):
            self.faces += _faces(rect, 1, 2 + 2 * (number % 3))

    def with_obstacles(self, more: Sequence[Rect]) -> World:
        """Return this world with additional boxes."""
        left, bottom, right, top = self.bounds
        return World(right - left, top - bottom, (*self.obstacles, *more))

    def clearance(self, x: float, y: float) -> float:
        """Return the distance to the nearest wall or box, m; negative inside one."""
        left, bottom, right, top = self.bounds
        best = min(x - left, right - x, y - bottom, top - y)
        for box in self.obstacles:
            dx = max(box[0] - x, x - box[2])
            dy = max(box[1] - y, y - box[3])
            if dx < best and dy < best:
                best = min(best, math.hypot(dx, dy) if dx > 0 and dy > 0 else max(dx, dy))
        return best

    def grid(self, resolution: float) -> tuple[int, int, bytes]:
        """Draw the map: columns, rows and one byte per cell, from the lower left corner."""
        left, bottom, right, top = self.bounds
        columns = round((right - left) / resolution)
        rows = round((top - bottom) / resolution)
        spans = [
            (
                *_cells(rect.left - left, rect.right - left, resolution, columns),
                *_cells(rect.bottom - bottom, rect.top - bottom, resolution, rows),
            )
            for rect in self.obstacles
        ]
        edges = {0, 1, rows - 1, rows}
        for _, _, first, last in spans:
            edges |= {first, last}
        ordered = sorted(edges)
        bands: list[bytes] = []
        for first, last in pairwise(ordered):
            row = bytearray(FREE * columns)
            row[0:1] = row[-1:] = OCCUPIED
            if first == 0 or last == rows:
                row[:] = OCCUPIED * columns
            for start, stop, low, high in spans:
                if low <= first < high:
                    row[start:stop] = OCCUPIED * (stop - start)
            bands.append(bytes(row) * (last - first))
        return columns, rows, b"".join(bands)


def _cells(low: float, high: float, resolution: float, count: int) -> tuple[int, int]:
    """Return the cells that an interval touches, as a half-open range within 0 to `count`."""
    first, last = math.floor(low / resolution), math.ceil(high / resolution)
    return min(count, max(0, first)), min(count, max(0, last))


def _warehouse() -> World:
    racks = [
        Rect(x, y - 0.6, x + 12, y + 0.6) for x in (-16.0, 4.0) for y in (-14.0, -10.0, 10.0, 14.0)
    ]
    pillars = [Rect(x - 0.3, y - 0.3, x + 0.3, y + 0.3) for x in (-8.0, 8.0) for y in (-7.0, 7.0)]
    benches = [Rect(-14.0, -2.0, -12.0, 2.0), Rect(12.0, -3.0, 15.0, 1.0)]
    return World(40.0, 40.0, [*racks, *pillars, *benches])


WAREHOUSE = _warehouse()
"""40 m by 40 m: four aisles of racks, four pillars, two benches, a wide free middle."""
