"""The pose that a robot reports of itself, beside the path of a command."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rcp_kernel.errors import RcpError
from rcp_kernel.model import full_path
from rcp_kernel.tree.entry import Entry

__all__ = ["OwnPose"]

_MAX_AGE = 1.0  # s beyond which a height counts as unknown


class OwnPose:
    """`sensor/pose` of the robot of an entry."""

    def __init__(self, entry: Entry, entries: Mapping[str, Entry]) -> None:
        own = entry.unit.robot
        name = f"sensor/{own}/pose" if own else "sensor/pose"
        self.path = full_path(entry.tenant or "", entry.robot, name)
        self._entries = entries

    def frame(self) -> str | None:
        """Return the frame in which the robot reports its pose, if it does."""
        return getattr(self._latest(), "frame_id", None)

    def height(self, frame: Any) -> float | None:
        """Return the present height in a frame; None if it is unknown."""
        pose = self._entries.get(self.path)
        if pose is None or pose.stale or pose.age is None or pose.age > _MAX_AGE:
            return None
        value = self._latest()
        if getattr(value, "frame_id", None) != frame:
            return None
        height = getattr(getattr(value, "position", None), "z", None)
        return height if isinstance(height, float) and math.isfinite(height) else None

    def _latest(self) -> Any:
        pose = self._entries.get(self.path)
        if pose is None or pose.latest is None:
            return None
        try:
            return pose.latest.value
        except RcpError:  # reported as a fault of the backend
            return None
