"""Robots: where one is in the tree, and patterns of several."""

from __future__ import annotations

import re
from dataclasses import dataclass

from rcp_kernel.model import full_path
from rcp_kernel.tree.entry import Entry

__all__ = ["Place", "RobotPattern", "place_of"]

_PATTERN = re.compile(r"/tenant/([A-Za-z0-9_.-]+|\*)(?:/([A-Za-z0-9_./-]+|\*))?")


@dataclass(frozen=True, slots=True)
class Place:
    """A robot, as the inventory names it."""

    tenant: str
    robot: str | None

    @property
    def key(self) -> str:
        """Its path in the inventory."""
        return f"/tenant/{self.tenant}" + (f"/{self.robot}" if self.robot else "")

    def path(self, name: str) -> str:
        """Return the path of one of its resources, by its name without the robot."""
        return full_path(self.tenant, self.robot, name)


def place_of(entry: Entry) -> Place | None:
    """Return the robot of a resource; None for the gateway's own."""
    if entry.tenant is None:
        return None
    unit = entry.unit
    return Place(entry.tenant, "/".join(filter(None, (unit.owner.robot, unit.robot))) or None)


class RobotPattern:
    """`/tenant/alpha`, `/tenant/alpha/rover`, or with `*` for all of a tenant, or all tenants.

    :raises ValueError: the text is none of these.
    """

    def __init__(self, text: str) -> None:
        found = _PATTERN.fullmatch(text)
        if found is None:
            raise ValueError(
                f"{text[:80]!r} names no robot: write /tenant/alpha, /tenant/alpha/rover, or "
                "/tenant/alpha/* for each of them"
            )
        self.text = text
        self.tenant: str = found[1]
        self._robot: str | None = found[2]

    @property
    def exact(self) -> Place | None:
        """The one robot that it names; None if it may be several."""
        return None if "*" in (self.tenant, self._robot) else Place(self.tenant, self._robot)

    def matches(self, place: Place) -> bool:
        """Return whether it means a robot."""
        if self.tenant not in ("*", place.tenant):
            return False
        return place.robot is not None if self._robot == "*" else place.robot == self._robot
