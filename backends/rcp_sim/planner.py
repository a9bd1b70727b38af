"""Shortest paths around obstacles: A* over their corners, with straight legs between."""

from __future__ import annotations

import heapq
import math

from rcp_sim.world import Rect, World

__all__ = ["MARGIN", "Planner"]

MARGIN = 0.35  # m between the path and anything solid: the robot's radius and a safety margin
_ASIDE = 0.01  # m, so that a path around a corner does not touch the margin


class Planner:
    """Paths through one world; caches which corners see each other."""

    def __init__(self, world: World) -> None:
        self._inner = world.bounds.grown(-MARGIN)
        self._blocks = [rect.grown(MARGIN) for rect in world.obstacles]
        corners = [
            (x, y)
            for left, bottom, right, top in (rect.grown(_ASIDE) for rect in self._blocks)
            for x in (left, right)
            for y in (bottom, top)
        ]
        self._corners = [corner for corner in corners if self.free(*corner)]
        self._sees: dict[tuple[int, int], bool] = {}

    def free(self, x: float, y: float) -> bool:
        """Return whether the rover may be at a point."""
        return self._inner.holds(x, y) and not any(block.holds(x, y) for block in self._blocks)

    def clear(self, a: tuple[float, float], b: tuple[float, float]) -> bool:
        """Return whether the straight leg between two points keeps the margin."""
        return not any(_crosses(block, a, b) for block in self._blocks)

    def find_path(
        self, start: tuple[float, float], goal: tuple[float, float]
    ) -> list[tuple[float, float]] | None:
        """Return the points of the path, the goal last; None if there is no path."""
        if not self.free(*goal):
            return None
        begin = self._away(start)
        if begin is None:
            return None
        first = [] if begin == start else [begin]
        if self.clear(begin, goal):
            return [*first, goal]
        legs = self._search(begin, goal)
        return None if legs is None else [*first, *legs]

    def _away(self, point: tuple[float, float]) -> tuple[float, float] | None:
        """Return the point, or the nearest one outside the margins."""
        x, y = point
        for _ in range(4):  # leaving one margin may lead into the next
            if self.free(x, y):
                return x, y
            left, bottom, right, top = self._inner.grown(-_ASIDE)
            x, y = max(left, min(right, x)), max(bottom, min(top, y))
            for block in self._blocks:
                if block.holds(x, y):
                    x, y = _beside(block.grown(_ASIDE), x, y)
        return None

    def _search(
        self, start: tuple[float, float], goal: tuple[float, float]
    ) -> list[tuple[float, float]] | None:
        points = [*self._corners, start, goal]
        first, last = len(points) - 2, len(points) - 1
        cost = {first: 0.0}
        previous: dict[int, int] = {}
        done: set[int] = set()
        open_ = [(math.dist(start, goal), first)]
        while open_:
            _, here = heapq.heappop(open_)
            if here == last:
                legs = [goal]
                while (here := previous[here]) != first:
                    legs.append(points[here])
                return legs[::-1]
            if here in done:
                continue
            done.add(here)
            for there, point in enumerate(points):
                length = cost[here] + math.dist(points[here], point)
                if there in done or length >= cost.get(there, math.inf):
                    continue
                if self._visible(here, there, points):
                    cost[there] = length
                    previous[there] = here
                    heapq.heappush(open_, (length + math.dist(point, goal), there))
        return None

    def _visible(self, one: int, other: int, points: list[tuple[float, float]]) -> bool:
        if max(one, other) >= len(self._corners):
            return self.clear(points[one], points[other])
        pair = (one, other) if one < other else (other, one)
        seen = self._sees.get(pair)
        if seen is None:
            seen = self._sees[pair] = self.clear(points[one], points[other])
        return seen


def _beside(rect: Rect, x: float, y: float) -> tuple[float, float]:
    """Return the nearest point on the border."""
    sides = (
        (x - rect.left, (rect.left, y)),
        (rect.right - x, (rect.right, y)),
        (y - rect.bottom, (x, rect.bottom)),
        (rect.top - y, (x, rect.top)),
    )
    return min(sides)[1]


def _crosses(rect: Rect, a: tuple[float, float], b: tuple[float, float]) -> bool:
    """Return whether a leg passes through the inside of a rectangle (Liang-Barsky)."""
    enter, leave = 0.0, 1.0
    for start, end, low, high in (
        (a[0], b[0], rect.left, rect.right),
        (a[1], b[1], rect.bottom, rect.top),
    ):
        if max(start, end) <= low or min(start, end) >= high:
            return False
        if start != end:
            one, two = (low - start) / (end - start), (high - start) / (end - start)
            enter = max(enter, min(one, two))
            leave = min(leave, max(one, two))
    return enter < leave
