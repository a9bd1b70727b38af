"""Polygons in a plane, for fences: point-in-polygon test and validity check."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

__all__ = ["Corner", "Polygon"]

Corner = tuple[float, float]
_EDGE = 1e-9  # tolerance relative to the largest coordinate, within which a point is on an edge


class Polygon:
    """A simple polygon, including its boundary.

    :raises ValueError: it has fewer than three corners, repeated corners, or intersecting edges.
    """

    __slots__ = ("_edges", "_near", "corners")

    def __init__(self, corners: Sequence[Corner]) -> None:
        self.corners = tuple((float(x), float(y)) for x, y in corners)
        if len(self.corners) < 3:
            raise ValueError(f"has {len(self.corners)} corners; an area needs at least three")
        if not all(math.isfinite(c) for corner in self.corners for c in corner):
            raise ValueError("has a corner that is not a finite number")
        self._edges = tuple(zip((self.corners[-1], *self.corners[:-1]), self.corners, strict=True))
        self._near = _EDGE * max(abs(c) for corner in self.corners for c in corner)
        self._check()

    def _check(self) -> None:
        for a, b in self._edges:
            if a == b:
                raise ValueError(f"has the corner {list(a)} twice in a row")
        count = len(self._edges)
        for (i, one), (j, other) in combinations(enumerate(self._edges), 2):
            if j == i + 1:
                crossed = _folds(one[0], one[1], other[1])
            elif i == 0 and j == count - 1:
                crossed = _folds(other[0], other[1], one[1])
            else:
                crossed = _meet(*one, *other)
            if crossed:
                raise ValueError(f"crosses or touches itself near {list(one[1])}")

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point is inside or on the boundary."""
        inside = False
        for (xa, ya), (xb, yb) in self._edges:
            if _distance(x, y, xa, ya, xb, yb) <= self._near:
                return True
            if (ya > y) != (yb > y) and x < xa + (y - ya) / (yb - ya) * (xb - xa):
                inside = not inside
        return inside


def _distance(x: float, y: float, xa: float, ya: float, xb: float, yb: float) -> float:
    dx, dy = xb - xa, yb - ya
    along = ((x - xa) * dx + (y - ya) * dy) / (dx * dx + dy * dy)
    along = min(1.0, max(0.0, along))
    return math.hypot(x - xa - along * dx, y - ya - along * dy)


def _side(a: Corner, b: Corner, c: Corner) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _between(a: Corner, b: Corner, c: Corner) -> bool:
    """Return whether `c`, on the line through `a` and `b`, lies between them."""
    return min(a[0], b[0]) <= c[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= c[1] <= max(a[1], b[1])


def _folds(a: Corner, b: Corner, c: Corner) -> bool:
    """Return whether two edges that share `b` overlap."""
    if _side(a, b, c) != 0:
        return False
    return (a[0] - b[0]) * (c[0] - b[0]) + (a[1] - b[1]) * (c[1] - b[1]) > 0


def _meet(a: Corner, b: Corner, c: Corner, d: Corner) -> bool:
    sides = (_side(a, b, c), _side(a, b, d), _side(c, d, a), _side(c, d, b))
    if sides[0] * sides[1] < 0 and sides[2] * sides[3] < 0:
        return True
    places = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    return any(side == 0 and _between(*p) for side, p in zip(sides, places, strict=True))
