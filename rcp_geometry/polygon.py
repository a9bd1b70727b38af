"""Polygons in a plane, for fences and zones: what is inside, how far away, and whether one is simple."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

__all__ = ["Corner", "Polygon"]

Corner = tuple[float, float]
Edge = tuple[Corner, Corner]
_EDGE = 1e-9  # tolerance relative to the largest coordinate, within which a point is on an edge
_TESTS = 1_000_000  # pairs of edges that are compared, about 1 s; an outline needs a few per corner


class Polygon:
    """A simple polygon, including its boundary.

    :raises ValueError: it has fewer than three corners, repeated corners, or intersecting edges.
    """

    __slots__ = ("_edges", "_near", "box", "corners")

    def __init__(self, corners: Sequence[Corner]) -> None:
        self.corners = tuple((float(x), float(y)) for x, y in corners)
        if len(self.corners) < 3:
            raise ValueError(f"has {len(self.corners)} corners; an area needs at least three")
        if not all(math.isfinite(c) for corner in self.corners for c in corner):
            raise ValueError("has a corner that is not a finite number")
        self._edges = tuple(zip((self.corners[-1], *self.corners[:-1]), self.corners, strict=True))
        self._near = _EDGE * max(abs(c) for corner in self.corners for c in corner)
        self.box = (
            (min(x for x, _ in self.corners), min(y for _, y in self.corners)),
            (max(x for x, _ in self.corners), max(y for _, y in self.corners)),
        )
        """Its least and its greatest coordinates."""
        self._check()

    def _check(self) -> None:
        for a, b in self._edges:
            if a == b:
                raise ValueError(f"has the corner {list(a)} twice in a row")
        for i, j in _overlapping(self._edges):
            if self._crossed(min(i, j), max(i, j)):
                raise ValueError(f"crosses or touches itself near {list(self._edges[i][1])}")

    def _crossed(self, i: int, j: int) -> bool:
        one, other = self._edges[i], self._edges[j]
        if j == i + 1:
            return _folds(one[0], one[1], other[1])
        if i == 0 and j == len(self._edges) - 1:
            return _folds(other[0], other[1], one[1])
        return _meet(*one, *other)

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point is inside or on the boundary."""
        (left, low), (right, high) = self.box
        near, inside = self._near, False
        if not (left - near <= x <= right + near and low - near <= y <= high + near):
            return False
        for (xa, ya), (xb, yb) in self._edges:
            # Whether the edge is close enough to be looked at: most are not.
            beside = (xa + near < x and xb + near < x) or (xa - near > x and xb - near > x)
            above = (ya + near < y and yb + near < y) or (ya - near > y and yb - near > y)
            if not (beside or above) and _distance(x, y, xa, ya, xb, yb) <= near:
                return True
            if (ya > y) != (yb > y) and x < xa + (y - ya) / (yb - ya) * (xb - xa):
                inside = not inside
        return inside

    def edge_distance(self, x: float, y: float) -> float:
        """Return the distance of a point from the boundary, on whichever side it is."""
        return min(_distance(x, y, *a, *b) for a, b in self._edges)

    def box_distance(self, x: float, y: float) -> float:
        """Return the distance of a point from the box around the polygon; 0 inside of the box."""
        (left, low), (right, high) = self.box
        return math.hypot(max(left - x, x - right, 0.0), max(low - y, y - high, 0.0))

    def near(self, start: Corner, end: Corner, reach: float) -> bool:
        """Return whether a straight way comes within a distance of the polygon, or into it."""
        left, right = min(start[0], end[0]) - reach, max(start[0], end[0]) + reach
        low, high = min(start[1], end[1]) - reach, max(start[1], end[1]) + reach
        box = self.box
        if box[0][0] > right or box[1][0] < left or box[0][1] > high or box[1][1] < low:
            return False
        for a, b in self._edges:
            beside = (a[0] < left and b[0] < left) or (a[0] > right and b[0] > right)
            above = (a[1] < low and b[1] < low) or (a[1] > high and b[1] > high)
            if not (beside or above) and _apart(start, end, a, b) <= reach:
                return True
        return self.holds(*start)


def _overlapping(edges: Sequence[Edge]) -> Iterator[tuple[int, int]]:
    """Yield the pairs of edges whose boxes meet, found by a sweep along the longer axis.

    :raises ValueError: there are too many to look at.
    """
    spans = [
        tuple((min(a[axis], b[axis]), max(a[axis], b[axis])) for axis in (0, 1)) for a, b in edges
    ]
    lengths = [sum(span[axis][1] - span[axis][0] for span in spans) for axis in (0, 1)]
    extents = [
        max(span[axis][1] for span in spans) - min(span[axis][0] for span in spans)
        for axis in (0, 1)
    ]
    # The axis along which fewer edges lie beside each other.
    first = 0 if lengths[0] * extents[1] <= lengths[1] * extents[0] else 1
    tests, active = 0, list[int]()
    for i in sorted(range(len(edges)), key=lambda i: spans[i][first]):
        (begin, _), (low, high) = spans[i][first], spans[i][1 - first]
        active = [j for j in active if spans[j][first][1] >= begin]
        tests += len(active)
        if tests > _TESTS:
            raise ValueError("is too intricate to be checked")
        for j in active:
            other = spans[j][1 - first]
            if other[0] <= high and low <= other[1]:
                yield i, j
        active.append(i)


def _distance(x: float, y: float, xa: float, ya: float, xb: float, yb: float) -> float:
    dx, dy = xb - xa, yb - ya
    squared = dx * dx + dy * dy
    along = ((x - xa) * dx + (y - ya) * dy) / squared if squared else 0.0
    along = min(1.0, max(0.0, along))
    return math.hypot(x - xa - along * dx, y - ya - along * dy)


def _apart(a: Corner, b: Corner, c: Corner, d: Corner) -> float:
    """Return the distance of two segments."""
    if _meet(a, b, c, d):
        return 0.0
    return min(
        _distance(*a, *c, *d), _distance(*b, *c, *d), _distance(*c, *a, *b), _distance(*d, *a, *b)
    )


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
