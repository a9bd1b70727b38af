"""What stands still in a model: places where a base on wheels cannot be."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from rcp_kernel.errors import DeviceRejected
from rcp_mujoco.bindings import mujoco
from rcp_mujoco.simulation import Simulation

__all__ = ["Obstacles"]

_BOX, _CYLINDER = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_CYLINDER)
_UPRIGHT = 0.999  # cosine: a ramp can be driven on
_LOW = 0.05  # m above the floor: a base drives over it, or under what begins above _HIGH
_HIGH = 0.15


class _Solid(NamedTuple):
    name: str
    centre: Any
    axes: Any
    """Its x and y in the world, as rows."""
    half: Any
    """Half its size along these; of a cylinder, its radius twice."""
    is_round: bool

    def depth(self, place: Any) -> float:
        """Return how far inside a place is, m; negative outside."""
        off = self.axes @ (place - self.centre)
        if self.is_round:
            return float(self.half[0] - np.linalg.norm(off))
        return float((self.half - np.abs(off)).min())


class Obstacles:
    """The upright boxes and cylinders that belong to the world, not to a robot."""

    def __init__(self, simulation: Simulation, base: int) -> None:
        model, data = simulation.model, simulation.data
        self._reach = _width(model, base)
        self._solids = [
            solid for geom in range(model.ngeom) if (solid := _solid(model, data, geom)) is not None
        ]

    def check(self, x: float, y: float, tolerance: float) -> None:
        """Refuse a goal that the base cannot come within `tolerance` (m) of.

        :raises DeviceRejected: the goal is inside an obstacle, or too near to one.
        """
        place = np.array((x, y))
        for solid in self._solids:
            if solid.depth(place) + self._reach > tolerance:
                raise DeviceRejected(
                    f"the goal is in an obstacle, or too near to one: '{solid.name}'",
                    remedy="Choose a goal farther away from it.",
                )


def _solid(model: Any, data: Any, geom: int) -> _Solid | None:
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if model.geom_bodyid[geom] != 0 or kind not in (_BOX, _CYLINDER):
        return None
    if not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
        return None
    turn, centre = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    is_round = kind == _CYLINDER
    half = size[1] if is_round else size[2]
    if turn[2, 2] < _UPRIGHT or centre[2] + half < _LOW or centre[2] - half > _HIGH:
        return None
    flat = np.array((size[0], size[0])) if is_round else size[:2].copy()
    name = model.geom(geom).name or f"geom {geom}"
    return _Solid(name, centre[:2].copy(), turn[:2, :2].T.copy(), flat, is_round)


def _width(model: Any, base: int) -> float:
    """Return half the width of the base's widest box or cylinder: what it needs in any heading."""
    widths = [
        float(min(model.geom_size[geom][:2]) if kind == _BOX else model.geom_size[geom][0])
        for geom in range(model.ngeom)
        if model.geom_bodyid[geom] == base
        and (kind := int(model.geom_type[geom])) in (_BOX, _CYLINDER)
    ]
    return max(widths, default=0.0)
