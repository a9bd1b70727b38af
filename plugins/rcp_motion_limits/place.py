"""Where a command leads, or where the robot stands, against the areas of a fence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rcp_kernel.contract.fields import Field
from rcp_kernel.errors import RcpError
from rcp_kernel.model import full_path
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_motion_limits.config import Fence
from rcp_motion_limits.polygon import Polygon

__all__ = ["Place"]


class Place:
    """A fence, and how to find the point that it is about."""

    def __init__(self, fence: Fence, entry: Entry, entries: Mapping[str, Entry]) -> None:
        self.point = (Field(fence.point[0]), Field(fence.point[1]))
        self.sensor = None
        """The path that says where the robot is; None: the command says where it leads."""
        if fence.of is not None:
            self.sensor = full_path(entry.tenant or "", entry.robot, fence.of)
        self._inside = {name: Polygon(corners) for name, corners in fence.inside.items()}
        self._outside = {name: Polygon(corners) for name, corners in fence.outside.items()}
        self._max_age = fence.max_age
        self._entries = entries

    def trouble(self, x: float, y: float) -> tuple[list[str], str] | None:
        """Return the areas that a point offends, with a clause for a person; None if it is good."""
        if self._inside and not any(area.holds(x, y) for area in self._inside.values()):
            names = list(self._inside)
            return names, f"is outside of {' and '.join(names)}"
        for name, area in self._outside.items():
            if area.holds(x, y):
                return [name], f"is in {name}"
        return None

    def commanded(self, value: Any) -> tuple[float, float] | None:
        """Return where a value leads, or None if it does not say so."""
        return _point(self.point[0].one(value), self.point[1].one(value))

    def of_sample(self, sample: Sample) -> tuple[float, float] | None:
        """Return where a sample says the robot is, or None if it does not."""
        try:
            return self.commanded(sample.value)
        except RcpError:  # noted as the backend's fault
            return None

    def present(self) -> tuple[float, float] | None:
        """Return where the robot is, or None while that cannot be known."""
        entry = self._entries.get(self.sensor or "")
        if entry is None or entry.latest is None or entry.stale:
            return None
        age = entry.age
        return None if age is None or age > self._max_age else self.of_sample(entry.latest)


def _point(x: Any, y: Any) -> tuple[float, float] | None:
    for number in (x, y):
        if isinstance(number, bool) or not isinstance(number, (int, float)):
            return None
        if not math.isfinite(number):
            return None
    return float(x), float(y)
