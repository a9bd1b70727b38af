"""From one frame to another: places, orientations and directions."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any

import msgspec
from msgspec import Meta
from msgspec.structs import replace

from rcp_geometry import Rigid, geodetic, heading, local
from rcp_geometry.rigid import Quat, Vec

__all__ = ["GeoPoint", "Move"]


class GeoPoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A place on the earth (WGS 84)."""

    latitude: Annotated[float, Meta(ge=-90, le=90, extra_json_schema={"unit": "deg"})]
    longitude: Annotated[float, Meta(ge=-180, le=180, extra_json_schema={"unit": "deg"})]
    altitude: Annotated[
        float, Meta(description="Above mean sea level.", extra_json_schema={"unit": "m"})
    ]


class Move:
    """A transform from a value's frame to the one that a client named."""

    def __init__(self, target: str, pose: Rigid, *, geographic: bool) -> None:
        """`pose` is that of the value's frame in the target, or in the frame of the earth."""
        self.target = target
        self.geographic = geographic
        self._pose = pose

    def place(self, value: Any, at: Vec) -> Any:
        """Return a position, of the type of `value` or by latitude and longitude."""
        x, y, z = self._pose.point(at)
        return GeoPoint(*geodetic((x, y, z))) if self.geographic else replace(value, x=x, y=y, z=z)

    def turned(self, orientation: Quat, at: Vec | None) -> Quat:
        """Return an orientation; on the earth, as seen from east, north and up at its place."""
        if not self.geographic:
            return self._pose.turn(orientation)
        there = self._level if at is None else _level(self._pose, at)
        return there.turn(orientation)

    def vector(self, along: Vec) -> Vec:
        """Return a direction; on the earth, along east, north and up at the origin of its frame."""
        return (self._level if self.geographic else self._pose).vector(along)

    def covariance(self, numbers: Any) -> Any:
        """Return the covariance of three numbers along the axes and three about them, row by row."""
        pose = self._level if self.geographic else self._pose
        rows = [list(numbers[6 * row : 6 * row + 6]) for row in range(6)]
        rows = [_both(pose, row) for row in rows]
        columns = [_both(pose, [row[at] for row in rows]) for at in range(6)]
        turned = [columns[at][row] for row in range(6) for at in range(6)]
        return type(numbers)(turned) if isinstance(numbers, (list, tuple)) else turned

    @staticmethod
    def heading(orientation: Quat) -> float:
        """Return the heading of an orientation on the earth, rad."""
        return heading(orientation)

    @cached_property
    def _level(self) -> Rigid:
        return _level(self._pose, (0.0, 0.0, 0.0))


def _level(pose: Rigid, at: Vec) -> Rigid:
    """Return a frame's pose, given in the earth's, in the local frame of one of its points."""
    return local(*geodetic(pose.point(at))).inverse.join(pose)


def _both(pose: Rigid, numbers: list[float]) -> list[float]:
    """Turn the first three numbers and the last three."""
    a, b, c, d, e, f = numbers
    return [*pose.vector((a, b, c)), *pose.vector((d, e, f))]
