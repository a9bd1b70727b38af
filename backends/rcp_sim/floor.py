"""The floor of the hall: the fixed world, and the boxes placed at run time."""

from __future__ import annotations

import math

from rcp_kernel.errors import DeviceRejected
from rcp_sim.messages import Box
from rcp_sim.planner import MARGIN, Planner
from rcp_sim.world import Rect, World

__all__ = ["MAX_PLACED", "Floor"]

MAX_PLACED = 16  # boxes: limits the time of path planning


class Floor:
    """A world in which boxes can be placed and removed, with a path planner."""

    def __init__(self, bare: World) -> None:
        self._bare = bare
        self._boxes = 0
        self.placed: dict[str, Box] = {}
        self.world = bare
        self.planner = Planner(bare)

    def place(self, box: Box, rover: tuple[float, float]) -> str:
        """Place a box; return its name.

        :raises DeviceRejected: it overlaps the rover, is outside, or there are too many boxes.
        """
        if len(self.placed) >= MAX_PLACED:
            raise DeviceRejected(
                f"there are already {MAX_PLACED} boxes",
                remedy="Remove one first: service/remove_obstacle.",
            )
        if not self.world.bounds.holds(box.x, box.y):
            raise DeviceRejected("that position is outside the warehouse")
        outline = Rect.of(box)
        x, y = rover
        dx = max(outline.left - x, x - outline.right, 0.0)
        dy = max(outline.bottom - y, y - outline.top, 0.0)
        if math.hypot(dx, dy) < MARGIN:
            raise DeviceRejected("the rover is there", remedy="Place it elsewhere.")
        self._boxes += 1
        name = f"box-{self._boxes}"
        self._rebuild({**self.placed, name: box})
        return name

    def remove(self, name: str) -> None:
        """Remove a box.

        :raises DeviceRejected: there is no box of that name.
        """
        if name not in self.placed:
            raise DeviceRejected(f"there is no box '{name}'")
        self._rebuild({key: box for key, box in self.placed.items() if key != name})

    def clear(self) -> int:
        """Remove every placed box; return their number."""
        count = len(self.placed)
        if count:
            self._rebuild({})
        return count

    def _rebuild(self, placed: dict[str, Box]) -> None:
        self.placed = placed
        self.world = self._bare.with_obstacles([Rect.of(box) for box in placed.values()])
        self.planner = Planner(self.world)
