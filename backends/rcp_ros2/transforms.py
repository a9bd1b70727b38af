"""`/tf` and `/tf_static`: each frame in the target frames, and any pair at any time."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from functools import partial
from time import time_ns
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.errors import AdapterUnavailable, DeviceRejected, InvalidValue, OutOfRange, RcpError
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress
from rcp_kernel.types import Point, Quaternion, Transform
from rcp_ros2.binding import Binding, Offer, Shared, common
from rcp_ros2.config import Mapping, Qos
from rcp_ros2.definitions import TF_MESSAGE
from rcp_ros2.frames import Extrapolation, Frames, NotConnected, Place, UnknownFrame
from rcp_ros2.graph import Graph
from rcp_ros2.idl import load
from rcp_ros2.names import legal
from rcp_ros2.types import kinds_of, outward

__all__ = ["Transforms"]

_STAMPED = "geometry_msgs/msg/TransformStamped"
_STATIC = Qos(reliability="reliable", durability="transient_local", depth=1000)
_MOVING = Qos(depth=1000)
_MOST = 500  # pairs with their own sensor
_SHOWN = 20  # frames that a message lists
_REP105 = {
    "earth": "the earth's centre, fixed to the earth (REP-105)",
    "map": "fixed to the world, without drift; poses in it may jump (REP-105)",
    "odom": "fixed to the world, drifts; poses in it are continuous (REP-105)",
    "base_link": "fixed to the robot's body, x forward, y left, z up (REP-103, REP-105)",
}


class Lookup(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The requested pair of frames and time."""

    target: Annotated[
        str, Meta(min_length=1, description="Target frame, in which the result is expressed.")
    ]
    source: Annotated[
        str, Meta(min_length=1, description="Source frame, whose position is requested.")
    ]
    time: (
        Annotated[
            float, Meta(description="Seconds since the epoch.", extra_json_schema={"unit": "s"})
        ]
        | None
    ) = None
    """The latest common time by default."""


class Transforms:
    """Finds the exposed frame trees: one per namespace with a `tf` topic."""

    def __init__(
        self, shared: Shared, exposes: Callable[[str], bool], on_jump: list[Callable[[], None]]
    ) -> None:
        self._shared = shared
        self._exposes = exposes
        on_jump.append(self._forget)
        self.trees: dict[str, Tree] = {}

    def _forget(self) -> None:
        for tree in list(self.trees.values()):
            tree.frames.forget_moving()

    def known(self, space: str) -> frozenset[str]:
        """Return the frames of a namespace; none if its tree is not exposed."""
        tree = self.trees.get(space) or self.trees.get("")
        return frozenset() if tree is None else tree.known.frames()

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return the sensors and the lookup of each tree."""
        found: dict[str, Offer] = {}
        topics = [topic for topic, type_ in graph.topics.items() if type_ == TF_MESSAGE]
        for topic in filter(self._exposes, topics):
            space = topic.rpartition("/")[0]
            if space not in self.trees:
                tree = self.trees[space] = Tree(self._shared, space)
                robot, _, _ = self._shared.naming.split(f"{space}/tf")
                self._shared.host.transforms(tree.known, robot)
        for topic in topics:  # a tree needs its static transforms
            tree = self.trees.get(topic.rpartition("/")[0])
            if tree is not None:
                tree.follow(topic)
        for tree in self.trees.values():
            found |= tree.offers()
        return found


class Tree:
    """The frames of one robot."""

    def __init__(self, shared: Shared, space: str) -> None:
        self.shared = shared
        self.frames = Frames(shared.config.tf.buffer)
        self.space = space
        self._followed: set[str] = set()
        self._version = -1
        self._paths: dict[str, str] = {}
        self._offers: dict[str, Offer] = {}
        self.known = KnownFrames(self.frames, lambda: shared.subscriptions.now() or time_ns())
        """The same for the gateway, which converts values with it."""

    def follow(self, topic: str) -> None:
        """Add the transforms of a topic."""
        if topic in self._followed:
            return
        self._followed.add(topic)
        static = topic.endswith("_static")
        qos = _STATIC if static else _MOVING
        take = partial(self._take, static)
        self.shared.ros.post(self.shared.listen, topic, TF_MESSAGE, f"{topic} frames", take, qos)

    def _take(self, static: bool, message: Any) -> None:  # noqa: FBT001 - bound by `partial`
        version = self.frames.version
        for stamped in message.transforms:
            stamp, moved = stamped.header.stamp, stamped.transform
            t, q = moved.translation, moved.rotation
            place = Place(t.x, t.y, t.z, q.x, q.y, q.z, q.w)
            time = stamp.sec * 1_000_000_000 + stamp.nanosec
            self.frames.put(
                stamped.child_frame_id, stamped.header.frame_id, time, place, static=static
            )
        if self.frames.version != version:
            self.shared.host.call_soon(self.shared.refresh)

    def offers(self) -> dict[str, Offer]:
        """Return the lookup service, and a sensor for each frame in each target frame."""
        if self.frames.version == self._version:
            return self._offers
        self._version = self.frames.version
        topic = f"{self.space}/tf"
        mapping = Mapping(topic=topic)
        name = self.shared.naming.path("service", f"{self.space}/lookup_transform")
        offers = {name: Offer(mapping, partial(LookupTransform, self, name, mapping))}
        pairs = self._pairs()
        more = len(pairs) > _MOST
        text = f"{topic} connects more than {_MOST} pairs of frames: use {name} for the rest"
        self.shared.trouble(f"{topic} pairs", text if more else None)
        named = {
            self._path(target, source): (target, source) for target, source in pairs[:_MOST]
        } | self._named()
        for name, (target, source) in named.items():
            offers[name] = Offer(mapping, partial(Moved, self, name, mapping, target, source))
        self._offers = offers
        return offers

    def _path(self, target: str, source: str) -> str:
        segments = self._segment(target), self._segment(source)
        return self.shared.naming.path("sensor", f"{self.space}/tf", after=segments)

    def _named(self) -> dict[str, tuple[str, str]]:
        """Return the connected pairs with configured names."""
        found: dict[str, tuple[str, str]] = {}
        robot, _, _ = self.shared.naming.split(f"{self.space}/tf")
        for path, pair in self.shared.config.tf.names.items():
            with contextlib.suppress(UnknownFrame, NotConnected):
                self.frames.lookup(*pair)
                found[self.shared.naming.below(path.removeprefix("/"), robot)] = pair
        return found

    def _segment(self, frame: str) -> str:
        if frame not in self._paths:
            self._paths[frame] = legal(frame.replace("/", "."), self._paths.values())
        return self._paths[frame]

    def _pairs(self) -> list[tuple[str, str]]:
        above = self.frames.tree()
        roots = {frame: _root(frame, above) for frame in (*above, *above.values())}
        wanted = [*self.shared.config.tf.targets, *sorted({r for r in roots.values() if r})]
        return [
            (target, source)
            for target in dict.fromkeys(wanted)
            for source, root in sorted(roots.items())
            if source != target and root and root == roots.get(target)
        ]

    def lookup(self, target: str, source: str, time: int | None = None) -> tuple[Place, int | None]:
        """Return the pose of a frame in another, and its time.

        :raises InvalidValue: there is no such frame.
        :raises DeviceRejected: they are not connected.
        :raises OutOfRange: one of them is not known at that time.
        """
        try:
            return self.frames.lookup(target, source, time)
        except UnknownFrame as error:
            raise _unknown(error, target) from None
        except NotConnected as error:
            raise DeviceRejected(
                str(error),
                remedy="Start the node that publishes the transform between them.",
                details={"parents": self.frames.tree()},
            ) from None
        except Extrapolation as error:
            raise _out_of_range(error) from None


class KnownFrames:
    """The `FrameTree` of a robot."""

    def __init__(self, frames: Frames, now: Callable[[], int]) -> None:
        self._frames, self._now = frames, now

    def frames(self) -> frozenset[str]:
        """Return the names of all frames."""
        parents = self._frames.tree()
        return frozenset(parents.keys()) | frozenset(parents.values())

    def lookup(self, target: str, source: str, time: int | None) -> tuple[Transform, float]:
        """Return the pose of a frame in another, and by how many seconds it misses the time.

        :raises LookupError: they are not connected.
        """
        wanted = self._now() if time is None else time
        try:
            try:
                place, found = self._frames.lookup(target, source, wanted)
            except Extrapolation:
                place, found = self._frames.lookup(target, source)
        except (UnknownFrame, NotConnected, Extrapolation) as error:
            raise LookupError(str(error)) from None
        moved = Transform(Point(*place[:3]), Quaternion(*place[3:]), target, source)
        return moved, 0.0 if found is None else abs(wanted - found) / 1e9


def _root(frame: str, above: dict[str, str]) -> str | None:
    """Return the root of a frame's tree; None for a cycle."""
    seen = {frame}
    while frame in above:
        frame = above[frame]
        if frame in seen:
            return None
        seen.add(frame)
    return frame


def _unknown(error: UnknownFrame, target: str) -> InvalidValue:
    names = ", ".join(error.near or error.known[:_SHOWN])
    return InvalidValue(
        str(error),
        remedy=f"Known frames: {names}."
        if names
        else "No frame is known yet: start the nodes that publish transforms.",
        details={
            "pointer": "/target" if f"'{target.lstrip('/')}'" in str(error) else "/source",
            "near": error.near,
        },
    )


def _out_of_range(error: Extrapolation) -> OutOfRange:
    first, last = error.first / 1e9, error.last / 1e9
    late = error.at > error.last
    by = (error.at - error.last if late else error.first - error.at) / 1e9
    return OutOfRange(
        f"the frame '{error.child}' is known from {first:.6f} to {last:.6f} s; the requested time "
        f"is {by:.6f} s {'after' if late else 'before'} that",
        remedy="Omit `time` for the latest, or use a time in this range.",
        details={"pointer": "/time", "frame": error.child, "value": error.at / 1e9}
        | {"first": first, "last": last},
    )


def _pair_type(target: str, source: str) -> Any:
    """Return geometry_msgs/TransformStamped with the frames in its schema."""
    stamped = kinds_of(outward(load(_STAMPED)))
    header = msgspec.defstruct(
        "Header",
        [
            ("stamp", kinds_of(stamped["header"])["stamp"]),
            ("frame_id", _frame(target)),
        ],
        frozen=True,
    )
    return msgspec.defstruct(
        "TransformStamped",
        [
            ("header", header),
            ("child_frame_id", _frame(source)),
            ("transform", stamped["transform"]),
        ],
        frozen=True,
    )


def _frame(name: str) -> Any:
    known = _REP105.get(name.rpartition("/")[2])
    return Annotated[Literal[name], Meta(description=known)] if known else Literal[name]


def _maker(type_: Any) -> Callable[[str, str, Place, int | None], Any]:
    """Return a function that creates a value of such a type."""
    kinds = kinds_of(type_)
    header, transform = kinds["header"], kinds["transform"]
    stamp = kinds_of(header)["stamp"]
    vector = kinds_of(transform)["translation"]
    quaternion = kinds_of(transform)["rotation"]

    def make(target: str, source: str, place: Place, time: int | None) -> Any:
        return type_(
            header(stamp(*divmod(time or 0, 1_000_000_000)), target),
            source,
            transform(vector(*place[:3]), quaternion(*place[3:])),
        )

    return make


class Moved(Binding):
    """The current transform of one frame in another."""

    def __init__(self, tree: Tree, name: str, mapping: Mapping, target: str, source: str) -> None:
        self.tree = tree
        self._pair = target, source
        self._publishing: asyncio.Task[None] | None = None
        type_ = _pair_type(target, source)
        self._make = _maker(type_)
        text = f"Transform of the frame {source} in {target}"
        if known := _REP105.get(target):
            text += f", which is {known}"
        facts = common(name, mapping, text, target=target, source=source)
        super().__init__(tree.shared, Resource(value=type_, **facts), mapping)

    async def read(self) -> Any:
        """Return the transform at the latest common time.

        :raises AdapterUnavailable: the frames are no longer connected.
        """
        return self._lookup()[0]

    def _lookup(self) -> tuple[Any, int | None]:
        try:
            place, time = self.tree.lookup(*self._pair)
        except RcpError as error:
            raise AdapterUnavailable(error.message, remedy=error.remedy) from None
        return self._make(*self._pair, place, time), time

    def watched(self, rate: float) -> None:
        """Publish new transforms, at most `rate` per second."""
        self.unwatched()
        pause = 1 / min(rate, self.shared.config.tf.rate)
        self._publishing = asyncio.ensure_future(self._publish_all(pause))

    async def _publish_all(self, pause: float) -> None:
        last: Any = None
        while True:
            with contextlib.suppress(AdapterUnavailable):  # a part of the tree is currently missing
                value, time = self._lookup()
                if value != last:
                    self.shared.host.publish(self.resource.name, value, time)
                    last = value
            await asyncio.sleep(pause)

    def unwatched(self) -> None:
        """Stop publishing."""
        if self._publishing is not None:
            self._publishing.cancel()
            self._publishing = None

    def close(self) -> None:
        """Stop publishing."""
        self.unwatched()


class LookupTransform(Binding):
    """The transform of any frame in any other, at any time in the buffer."""

    def __init__(self, tree: Tree, name: str, mapping: Mapping) -> None:
        self.tree = tree
        output = outward(load(_STAMPED))
        self._make = _maker(output)
        span = tree.shared.config.tf.buffer
        text = f"Transform of one frame in another, now or at a time within the last {span:g} s"
        resource = Resource(
            input=Lookup,
            output=output,
            examples=({"target": "map", "source": "base_link"},),
            **common(name, mapping, text, topic=mapping.topic, **READS),
        )
        super().__init__(tree.shared, resource, mapping)

    async def execute(self, value: Any, progress: Progress) -> Any:
        """Look the transform up; raises as `Tree.lookup`."""
        at = None if value.time is None else round(value.time * 1e9)
        place, time = self.tree.lookup(value.target, value.source, at)
        return self._make(value.target.lstrip("/"), value.source.lstrip("/"), place, time)
