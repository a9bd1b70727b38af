"""The areas of a fence that was uploaded: polygons and circles to stay in or out of."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rcp_geometry import Polygon
from rcp_mavlink.geo import distance, offset
from rcp_mavlink.messages import Item

__all__ = ["Enclosure"]

_IN, _OUT = "INCLUSION", "EXCLUSION"
_POLYGON, _CIRCLE = "NAV_FENCE_POLYGON_VERTEX_", "NAV_FENCE_CIRCLE_"
Place = tuple[float, float]


class Enclosure:
    """The areas of one fence; `union`: to be in one of several to stay in is enough."""

    def __init__(self, items: Sequence[Item], *, union: bool) -> None:
        """Take the items of a fence.

        :raises ValueError: a polygon crosses itself or has no area; says what is wrong.
        """
        self._union = union
        self._circles: list[tuple[bool, Place, float]] = []
        self._polygons: list[tuple[bool, Place, Polygon]] = []
        """Whether to stay in it, a corner (deg), and its corners from there, m."""
        at = 0
        while at < len(items):
            item = items[at]
            name, inner = item.command, item.command.endswith(_IN)
            size = item.params[0] if item.params else None
            if name in (_CIRCLE + _IN, _CIRCLE + _OUT):
                self._circles.append((inner, (item.latitude, item.longitude), size or 0.0))
            elif name in (_POLYGON + _IN, _POLYGON + _OUT):
                corners = items[at : at + max(1, int(size or 0))]
                self._add(inner, [(each.latitude, each.longitude) for each in corners])
                at += len(corners) - 1
            at += 1

    def _add(self, inner: bool, corners: list[Place]) -> None:  # noqa: FBT001 - as stored
        first = corners[0]
        polygon = Polygon([offset(lat, lon, first) for lat, lon in corners])
        self._polygons.append((inner, first, polygon))

    def left(self, place: Place) -> str | None:
        """Describe what a position (deg) violates; None if nothing."""
        inside = [
            *((inner, distance(place, at) <= radius) for inner, at, radius in self._circles),
            *((inner, area.holds(*offset(*place, at))) for inner, at, area in self._polygons),
        ]
        if any(within for inner, within in inside if not inner):
            return "it is in an area of the fence to stay out of"
        within = [each for inner, each in inside if inner]
        kept = any(within) if self._union else all(within)
        return None if kept or not within else "it is outside the area of the fence"


def ahead(speed: float, fastest: float, seconds: float, change: float) -> float:
    """Return how far (m) something still goes that brakes after `seconds`, and gains speed until then.

    Both at `change` (m/s2); it gains no more than up to `fastest` (m/s).
    """
    now = abs(speed)
    then = max(now, min(fastest, now + change * seconds))
    return math.copysign((now + then) / 2 * seconds + then * then / (2 * change), speed)
