"""Positions, commanded or measured, checked against the areas of a fence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import msgspec

from rcp_conditions.fields import Field
from rcp_geometry import Polygon
from rcp_kernel.errors import RcpError
from rcp_kernel.model import full_path
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_motion_limits.config import Fence
from rcp_motion_limits.own_pose import OwnPose

__all__ = ["FenceCheck"]


class FenceCheck:
    """A fence, and the location of the position that it checks."""

    def __init__(self, fence: Fence, entry: Entry, entries: Mapping[str, Entry]) -> None:
        self.point = (Field(fence.point[0]), Field(fence.point[1]))
        self.sensor = None
        """The path of the position sensor; None uses the position in the command."""
        if fence.of is not None:
            self.sensor = full_path(entry.tenant or "", entry.robot, fence.of)
        self._inside = {name: Polygon(corners) for name, corners in fence.inside.items()}
        self._outside = {name: Polygon(corners) for name, corners in fence.outside.items()}
        self._max_age = fence.max_age
        self._entries = entries
        self._pose = OwnPose(entry, entries)
        self._entry = entry

    def trouble(self, x: float, y: float) -> tuple[list[str], str] | None:
        """Return the violated areas with a clause for messages; None if there are none."""
        if self._inside and not any(area.holds(x, y) for area in self._inside.values()):
            names = list(self._inside)
            return names, f"is outside of {' and '.join(names)}"
        for name, area in self._outside.items():
            if area.holds(x, y):
                return [name], f"is in {name}"
        return None

    def commanded(self, value: Any) -> tuple[float, float] | None:
        """Return the commanded position, or None if the value contains none."""
        return _point(self.point[0].one(value), self.point[1].one(value))

    def foreign(self, value: Any) -> str | None:
        """Return the frame of a commanded position, unless it is that of the fence.

        Goals are converted to the frame of the robot's pose before they are checked; one that names
        another frame is known only to the robot.
        """
        frame = getattr(value, "frame", None)
        if not isinstance(frame, str):
            return None
        unit = self._entry.unit
        declared = next(iter(unit.facts.frames or unit.whole.facts.frames), None)
        own = declared or self._pose.frame() or _default_frame(type(value))
        return None if frame == own else frame

    def of_sample(self, sample: Sample) -> tuple[float, float] | None:
        """Return the robot's position in a sample, or None if it contains none."""
        try:
            return self.commanded(sample.value)
        except RcpError:  # reported as a fault of the backend
            return None

    @property
    def remaining(self) -> float:
        """Seconds for which the latest position still counts as known; at most 0 if it does not."""
        entry = self._entries.get(self.sensor or "")
        age = None if entry is None else entry.age
        if entry is None or age is None:
            return 0.0
        limit = self._max_age if entry.deadline is None else min(self._max_age, entry.deadline)
        return limit - age

    def present(self) -> tuple[float, float] | None:
        """Return the robot's current position, or None if it is unknown."""
        entry = self._entries.get(self.sensor or "")
        if entry is None or entry.latest is None or entry.stale:
            return None
        age = entry.age
        return None if age is None or age > self._max_age else self.of_sample(entry.latest)


@cache
def _default_frame(type_: Any) -> Any:
    """Return the frame of goals that name none."""
    known = msgspec.structs.fields(type_) if issubclass(type_, msgspec.Struct) else ()
    return next((field.default for field in known if field.name == "frame"), None)


def _point(x: Any, y: Any) -> tuple[float, float] | None:
    for number in (x, y):
        if isinstance(number, bool) or not isinstance(number, (int, float)):
            return None
        if not math.isfinite(number):
            return None
    return float(x), float(y)
