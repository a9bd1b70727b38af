"""The frames of one robot, and the transforms between them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from functools import lru_cache, partial
from typing import NamedTuple

from rcp_frames.config import EARTH, FramesConfig
from rcp_frames.shapes import Shape, shape_of
from rcp_geometry import IDENTITY, NED, Rigid, local
from rcp_kernel.errors import InvalidValue, PreconditionFailed, RcpError
from rcp_kernel.model import full_path
from rcp_kernel.spi import Anchor, FrameTree
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample

__all__ = [
    "FrameAccess",
    "Moment",
    "RobotFrames",
    "no_transform",
    "pose_path",
    "remote_poses",
    "robot_of",
    "tree_poses",
]

_POSES = ("pose", "odometry")
_SHOWN = 20  # frames that a message lists
_MOST = 50  # frames of a tree that are listed
_NEXT = 0.25  # s after which to try again when a pose has just been requested


class FrameAccess(Enum):
    """Which transforms a principal may know."""

    FIXED = "those that do not tell where a robot is"
    OWN = "those of the robot alone as well"
    ALL = "those that its backend has for all its robots as well"


class Moment(NamedTuple):
    """The time of a value."""

    stamp: int | None
    """By the robot's clock, ns; None: now."""
    received: int
    """By the gateway's, ns."""


class _Edge(NamedTuple):
    """A transform from one frame to another."""

    outer: str
    inner: str
    pose: Callable[[Moment], Rigid]


def robot_of(entry: Entry) -> str:
    """Return the place of an entry's robot: `/tenant/alpha/r1`, or `/tenant/alpha`."""
    names = filter(None, (entry.robot, entry.unit.robot))
    return "/".join(("/tenant", entry.tenant or "", *names))


def pose_path(entry: Entry) -> str:
    """Return the path of the pose of an entry's robot."""
    return _beside(entry, "pose")


def tree_poses(entry: Entry) -> list[str]:
    """Return the paths of the poses of all robots whose frames are in the tree of an entry's robot."""
    unit = entry.unit
    if unit.whole.frames is None or (unit.robot is not None and unit.frames is not None):
        return []
    names = (one.robot for one in entry.owner.units if one.robot is not None)
    tenant = entry.tenant or ""
    return [full_path(tenant, entry.robot, f"sensor/{name}/pose") for name in names]


def remote_poses(entry: Entry) -> list[str]:
    """Return the paths of the poses of all robots that the own gateway of an entry's robot has.

    Which of them share transforms, only that gateway knows.
    """
    own = entry.unit.own.items()
    told = [one.path for name, one in own if name.startswith("sensor/") and name.endswith("/pose")]
    return list(dict.fromkeys((pose_path(entry), *told)))


def _beside(entry: Entry, name: str) -> str:
    own = entry.unit.robot
    return full_path(
        entry.tenant or "", entry.robot, f"sensor/{own}/{name}" if own else f"sensor/{name}"
    )


def no_transform(frame: str, source: str, known: list[str]) -> InvalidValue:
    """Return the error of a frame that nothing connects to another one."""
    shown = ", ".join(known[:_SHOWN])
    return InvalidValue(
        f"there is no transform between the frames '{source}' and '{frame}'",
        remedy=f"Known frames: {shown}.",
        details={"pointer": "/frame", "frames": known},
    )


class RobotFrames:
    """The frames of an entry's robot, as far as a principal may know them."""

    def __init__(
        self,
        entry: Entry,
        entries: Mapping[str, Entry],
        config: FramesConfig,
        *,
        access: FrameAccess,
        request: Callable[[Entry], None],
    ) -> None:
        """`request` is called with a pose that is published only for subscribers."""
        self._entry, self._entries, self._config = entry, entries, config
        self._moving, self._shared = access is not FrameAccess.FIXED, access is FrameAccess.ALL
        self._request = request
        self._place, self._pose_path = robot_of(entry), pose_path(entry)

    def transform(self, target: str, source: str, moment: Moment) -> Rigid:
        """Return the pose of a frame in another.

        :raises InvalidValue: nothing connects them.
        :raises PreconditionFailed: the pose that does is too old.
        """
        if target == source:
            return IDENTITY
        way = self._ways(source, {target, source}).get(target)
        if way is None:
            raise no_transform(target, source, self.known(source))
        pose = IDENTITY
        for link, inwards in way:
            step = link.pose(moment)
            pose = (step if inwards else step.inverse).join(pose)
        return pose

    def known(self, source: str) -> list[str]:
        """Return the frames that are connected to one, itself included."""
        tree = self._tree
        names = () if tree is None else sorted(tree.frames())[:_MOST]
        return sorted(self._ways(source, set(names)))

    def _ways(self, source: str, wanted: set[str]) -> dict[str, list[tuple[_Edge, bool]]]:
        """Return the links from a frame to every other; for each, whether its inner end comes first.

        Of the frames of a tree there are those of `wanted`, and where other links begin.
        """
        links = self._links()
        tree = self._tree
        if tree is not None:
            wanted = wanted | {name for link in links for name in (link.outer, link.inner)}
            wanted &= set(tree.frames())
        ways: dict[str, list[tuple[_Edge, bool]]] = {source: []}
        waiting = deque([source])
        while waiting:
            name = waiting.popleft()
            near = [*links]
            if tree is not None and name in wanted:  # first: it knows the time of its transforms
                near[:0] = [
                    self._looked_up(tree, name, other)
                    for other in wanted - ways.keys()
                    if _is_connected(tree, other, name)
                ]
            for link in near:
                other = link.outer if link.inner == name else link.inner
                if name in (link.outer, link.inner) and other not in ways:
                    ways[other] = [*ways[name], (link, link.inner == name)]
                    waiting.append(other)
        return ways

    @property
    def base(self) -> str | None:
        """The frame in which the robot reports its own pose; None: unknown."""
        return next((link.outer for link in self._posed()), None) if self._moving else None

    # Links

    @property
    def _tree(self) -> FrameTree | None:
        if not self._moving:
            return None
        unit = self._entry.unit
        own = None if unit.robot is None else unit.frames
        return own or (unit.whole.frames if self._shared else None)

    def _links(self) -> list[_Edge]:
        links = [self._fixed(EARTH, name, pose) for name, pose in self._origins()]
        anchor = self.anchor
        if anchor is not None:
            pose = _placed(anchor.latitude, anchor.longitude, anchor.altitude, anchor.yaw)
            links.append(self._fixed(EARTH, anchor.frame, pose))
        if self._moving:
            links += self._posed()
        return links

    @staticmethod
    def _fixed(outer: str, inner: str, pose: Rigid) -> _Edge:
        return _Edge(outer, inner, lambda _: pose)

    def _origins(self) -> Iterator[tuple[str, Rigid]]:
        for name, one in self._config.origins.items():
            if one.tenant is None or one.tenant == self._entry.tenant:
                pose = _placed(one.latitude, one.longitude, one.altitude, 0.0)
                down = one.axes == "ned"
                yield name, pose._replace(rotation=pose.turn(NED)) if down else pose

    @property
    def anchor(self) -> Anchor | None:
        """Where one of its frames is on the earth now."""
        configured = self._config.anchors.get(self._place)
        if configured is not None:
            return configured
        pose = self._entries.get(self._pose_path)
        for entry in (self._entry, pose):
            unit = None if entry is None else entry.unit
            if unit is not None and (found := unit.anchor or unit.whole.anchor) is not None:
                return found
        return None

    def _posed(self) -> Iterator[_Edge]:
        """List the links that the robot's own poses are."""
        for name in _POSES:
            entry = self._entries.get(_beside(self._entry, name))
            shape = None if entry is None else shape_of(entry.resource.value)
            if entry is None or shape is None:
                continue
            outer, inner = shape.default, "base_link"
            if entry.latest is None and not entry.live:
                self._request(entry)
            if entry.latest is not None:
                try:
                    value = entry.latest.value
                except RcpError:  # reported as its backend's fault
                    continue
                outer, inner = shape.frame_of(value), shape.child_of(value)
            if outer != inner:
                yield _Edge(outer, inner, partial(self._measured, entry, shape))

    def _measured(self, entry: Entry, shape: Shape, moment: Moment) -> Rigid:
        """Return the pose that was measured nearest to a moment.

        :raises PreconditionFailed: there is none within the bound.
        """
        if not entry.live:
            self._request(entry)
        sample = _nearest(entry, moment.received)
        bound = self._config.max_age
        age = None if sample is None else abs(sample.received - moment.received) / 1e9
        if sample is None or age is None or age > bound:
            when = (
                "unknown" if age is None else f"{age:.1f} s away; at most {bound:g} s are allowed"
            )
            raise PreconditionFailed(
                f"the pose of the robot at this time is {when}",
                remedy=f"Wait until {entry.path} is published again, or ask for another frame.",
                retry_after=_NEXT,
                details={"age": age, "max_age": bound},
            )
        pose = shape.pose_of(sample.value)
        if pose is None:
            raise PreconditionFailed(f"{entry.path} has no pose with an orientation")
        return pose

    def _looked_up(self, tree: FrameTree, source: str, target: str) -> _Edge:
        return _Edge(target, source, partial(self._tree_pose, tree, source, target))

    def _tree_pose(self, tree: FrameTree, source: str, target: str, moment: Moment) -> Rigid:
        """Return a pose from the backend's own tree.

        :raises InvalidValue: the frames are no longer connected.
        :raises PreconditionFailed: its time is too far from that of the value.
        """
        try:
            found, age = tree.lookup(target, source, moment.stamp)
        except LookupError:
            raise no_transform(target, source, [source]) from None
        bound = self._config.max_age
        if age > bound:
            raise PreconditionFailed(
                f"the transform between '{source}' and '{target}' is {age:.1f} s away from the time "
                f"of the value; at most {bound:g} s are allowed",
                remedy="Check the node that publishes it, and the clocks of the robot.",
                details={"age": age, "max_age": bound},
            )
        t, r = found.translation, found.rotation
        return Rigid((t.x, t.y, t.z), (r.x, r.y, r.z, r.w))


_placed = lru_cache(1024)(local)


def _is_connected(tree: FrameTree, target: str, source: str) -> bool:
    try:
        tree.lookup(target, source, None)
    except LookupError:
        return False
    return True


def _nearest(entry: Entry, received: int) -> Sample | None:
    """Return the sample that arrived nearest to a time."""
    best: Sample | None = None
    for sample in reversed(entry.ring):
        if best is not None and abs(sample.received - received) > abs(best.received - received):
            break
        best = sample
    return best
