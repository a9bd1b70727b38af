"""The robots of the tree: each with its resources, by the scope that leases and e-stops use."""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections.abc import Callable, Iterable

from rcp_inventory.limits import Limits, frames_of, limits_of
from rcp_kernel.features import FeatureHost
from rcp_kernel.tree.entry import Entry, RobotUnit

__all__ = ["Fleet", "Member", "Robot"]


class Member:
    """One resource of a robot."""

    __slots__ = ("_frames", "_limits", "entry", "name")

    def __init__(self, entry: Entry) -> None:
        self.entry = entry
        self.name = _own_name(entry)
        """Its name without the robot's, such as `sensor/pose`."""
        self._limits: Limits | None = None
        self._frames: tuple[str, ...] | None = None

    @property
    def describes(self) -> bool:
        """Whether its limits say what the robot can do: it moves something, or is in a profile.

        The ranges of a vehicle's hundreds of own parameters say only how they are stored.
        """
        return self.entry.moves or bool(self.entry.resource.profiles)

    @property
    def limits(self) -> Limits:
        """The limits of what clients may send."""
        if self._limits is None:
            self._limits = limits_of(self.entry)
        return self._limits

    @property
    def frames(self) -> tuple[str, ...]:
        """The frames of its values or goals."""
        if self._frames is None:
            self._frames = tuple(frames_of(self.entry))
        return self._frames


class Robot:
    """One robot."""

    __slots__ = ("members", "path", "tenant")

    def __init__(self, path: str, tenant: str) -> None:
        self.path = path
        self.tenant = tenant
        self.members: dict[str, Member] = {}
        """Its resources by path."""


class Fleet:
    """Every robot of the tree, ordered by path."""

    def __init__(self, host: FeatureHost, *, changed: Callable[[], None]) -> None:
        """Follow the tree; `changed` is called when a robot may have changed."""
        self._robots: dict[str, Robot] = {}
        self._order: list[str] = []
        self._changed = changed
        for entry in host.robots.entries.values():
            self._added(entry)
        host.robots.follow(self._added, self._removed)

    def after(self, path: str) -> Iterable[Robot]:
        """Iterate over the robots after a path; they may come and go meanwhile."""
        for path_ in self._order[bisect_right(self._order, path) :]:
            robot = self._robots.get(path_)
            if robot is not None:
                yield robot

    def _added(self, entry: Entry) -> None:
        if entry.tenant is None:
            return
        path = _scope(entry.tenant, entry.unit)
        robot = self._robots.get(path)
        if robot is None:
            robot = self._robots[path] = Robot(path, entry.tenant)
            insort(self._order, path)
        robot.members[entry.path] = Member(entry)
        self._changed()

    def _removed(self, entry: Entry) -> None:
        if entry.tenant is None:
            return
        path = _scope(entry.tenant, entry.unit)
        robot = self._robots[path]
        robot.members.pop(entry.path, None)
        if not robot.members:
            del self._robots[path]
            del self._order[bisect_left(self._order, path)]
        self._changed()


def _scope(tenant: str, unit: RobotUnit) -> str:
    return (
        f"/tenant/{tenant}"
        if unit.robot_segment is None
        else f"/tenant/{tenant}/{unit.robot_segment}"
    )


def _own_name(entry: Entry) -> str:
    robot = entry.resource.robot
    branch, _, rest = entry.name.partition("/")
    if robot is None or not rest.startswith(f"{robot}/"):
        return entry.name
    return f"{branch}/{rest.removeprefix(f'{robot}/')}"
