"""The tree of coordinate frames over time.

Each frame is stored with its transforms to its parent: one static transform, or a list ordered by
time. Written in the ROS thread and read on the event loop, under a lock.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from threading import Lock
from typing import NamedTuple

from rcp_protocol.similarity import nearest

__all__ = ["Extrapolation", "Frames", "NotConnected", "Place", "UnknownFrame"]

_STRAYS = 3  # consecutive transforms older than the buffer: the clock was set back
_DEEP = 1000  # frames in one chain; more means a cycle


class Place(NamedTuple):
    """The transform of a frame in another: metres and a unit quaternion."""

    x: float
    y: float
    z: float
    qx: float
    qy: float
    qz: float
    qw: float


_HERE = Place(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


class UnknownFrame(Exception):
    """The frame is unknown."""

    def __init__(self, name: str, known: list[str]) -> None:
        super().__init__(f"there is no frame '{name}'")
        self.near = nearest(name, known)
        self.known = known


class NotConnected(Exception):
    """No chain of transforms leads from one frame to the other."""


class Extrapolation(Exception):
    """A frame has no transform at the requested time."""

    def __init__(self, child: str, at: int, first: int, last: int) -> None:
        super().__init__(f"the frame '{child}' is not known at this time")
        self.child = child
        self.at = at
        self.first = first
        """Earliest and latest known time, ns."""
        self.last = last


@dataclass(slots=True)
class _Track:
    """The transforms of one frame to its parents."""

    static: bool
    times: list[int] = field(default_factory=list[int])
    parents: list[str] = field(default_factory=list[str])
    places: list[Place] = field(default_factory=list[Place])
    strays: int = 0

    def at(self, child: str, time: int | None) -> tuple[str, Place]:
        """Return parent and transform at a time in ns; None is the latest."""
        if self.static or time is None:
            return self.parents[-1], self.places[-1]
        after = bisect_left(self.times, time)
        if after < len(self.times) and self.times[after] == time:
            return self.parents[after], self.places[after]
        if after in (0, len(self.times)):
            raise Extrapolation(child, time, self.times[0], self.times[-1])
        before = after - 1
        if self.parents[before] != self.parents[after]:
            return self.parents[before], self.places[before]
        part = (time - self.times[before]) / (self.times[after] - self.times[before])
        return self.parents[before], _between(self.places[before], self.places[after], part)


class Frames:
    """All frames of one robot."""

    def __init__(self, buffer: float) -> None:
        self._span = int(buffer * 1e9)
        self._tracks: dict[str, _Track] = {}
        self._lock = Lock()
        self.version = 0
        """Incremented whenever a frame appears or changes its parent."""

    def put(self, child: str, parent: str, time: int, place: Place, *, static: bool) -> None:
        """Add a transform; an invalid one is ignored."""
        child, parent = child.lstrip("/"), parent.lstrip("/")
        norm = math.hypot(*place[3:])
        if (
            not child
            or not parent
            or child == parent
            or not math.isfinite(sum(place))
            or norm < 0.5
        ):
            return
        place = Place(*place[:3], *(q / norm for q in place[3:]))
        with self._lock:
            track = self._tracks.get(child)
            if track is None or track.static != static:
                track = self._tracks[child] = _Track(static)
                self.version += 1
            elif track.parents[-1] != parent:
                self.version += 1
            self._insert(track, parent, time, place)

    def _insert(self, track: _Track, parent: str, time: int, place: Place) -> None:
        if track.static:
            track.times, track.parents, track.places = [time], [parent], [place]
            return
        if track.times and time < track.times[-1] - self._span:
            track.strays += 1
            if track.strays < _STRAYS:
                return
            track.times, track.parents, track.places = [], [], []
        track.strays = 0
        at = bisect_right(track.times, time)
        if at and track.times[at - 1] == time:
            track.parents[at - 1], track.places[at - 1] = parent, place
            return
        track.times.insert(at, time)
        track.parents.insert(at, parent)
        track.places.insert(at, place)
        old = bisect_left(track.times, track.times[-1] - self._span)
        if old > len(track.times) // 4:  # rarely, because it moves all remaining entries
            del track.times[:old], track.parents[:old], track.places[:old]

    def forget_moving(self) -> None:
        """Drop everything except static transforms, after a jump back in time."""
        with self._lock:
            self._tracks = {child: t for child, t in self._tracks.items() if t.static}
            self.version += 1

    def tree(self) -> dict[str, str]:
        """Return each frame with its current parent."""
        with self._lock:
            return {child: track.parents[-1] for child, track in self._tracks.items()}

    def is_static(self, target: str, source: str) -> bool:
        """Return whether all transforms between two frames are static."""
        with self._lock:
            try:
                return self._common_time(target, source) is None
            except NotConnected:
                return False

    def lookup(self, target: str, source: str, time: int | None = None) -> tuple[Place, int | None]:
        """Return the pose of `source` in `target`, at `time` or the latest common time.

        Times are in ns. The time of the pose is returned too; None if all transforms are static.

        :raises UnknownFrame: one of the frames is unknown.
        :raises NotConnected: there is no chain between them.
        :raises Extrapolation: a part of the chain is not known at that time.
        """
        target, source = target.lstrip("/"), source.lstrip("/")
        with self._lock:
            self._must_know(target)
            self._must_know(source)
            when = self._common_time(target, source) if time is None else time
            up, down = self._meet(target, source, when)
            place = _HERE
            for step in up:
                place = _joined(step, place)
            back = _HERE
            for step in down:
                back = _joined(step, back)
            return _joined(_inverse(back), place), when

    def _must_know(self, name: str) -> None:
        if name in self._tracks:
            return
        known = self._tracks.keys() | {track.parents[-1] for track in self._tracks.values()}
        if name not in known:
            raise UnknownFrame(name, sorted(known))

    def _common_time(self, target: str, source: str) -> int | None:
        """Return the latest time at which every moving frame of the chain is known."""
        ups = self._chain(source, None)
        downs = self._chain(target, None)
        common = {name for name, _ in ups} & {name for name, _ in downs}
        if not common:
            raise NotConnected(f"the frames '{source}' and '{target}' are not connected")
        between = [n for chain in (ups, downs) for n, _ in chain if n not in common]
        tracks = [self._tracks[name] for name in between]
        return min((t.times[-1] for t in tracks if not t.static), default=None)

    def _chain(self, name: str, time: int | None) -> list[tuple[str, Place]]:
        """Return the chain from a frame up to its root, each with its pose in the next."""
        chain: list[tuple[str, Place]] = []
        while (track := self._tracks.get(name)) is not None:
            parent, place = track.at(name, time)
            chain.append((name, place))
            name = parent
            if len(chain) > _DEEP:
                raise NotConnected(f"the parents of frame '{name}' form a cycle")
        chain.append((name, _HERE))
        return chain

    def _meet(self, target: str, source: str, time: int | None) -> tuple[list[Place], list[Place]]:
        """Return the poses from each frame up to their nearest common ancestor."""
        ups, downs = self._reach(source, target, time), self._reach(target, source, time)
        above = {name: at for at, (name, _) in enumerate(downs)}
        for at, (name, _) in enumerate(ups):
            if name in above:
                return [p for _, p in ups[:at]], [p for _, p in downs[: above[name]]]
        raise NotConnected(f"the frames '{source}' and '{target}' were not connected at that time")

    def _reach(self, name: str, other: str, time: int | None) -> list[tuple[str, Place]]:
        """Return the chain at a time, without the frames above the common ancestor."""
        latest = {n for n, _ in self._chain(other, None)}
        chain: list[tuple[str, Place]] = []
        while (track := self._tracks.get(name)) is not None and len(chain) <= _DEEP:
            if name in latest:
                break
            parent, place = track.at(name, time)
            chain.append((name, place))
            name = parent
        chain.append((name, _HERE))
        return chain


def _rotated(q: Place, x: float, y: float, z: float) -> tuple[float, float, float]:
    tx = 2 * (q.qy * z - q.qz * y)
    ty = 2 * (q.qz * x - q.qx * z)
    tz = 2 * (q.qx * y - q.qy * x)
    return (
        x + q.qw * tx + q.qy * tz - q.qz * ty,
        y + q.qw * ty + q.qz * tx - q.qx * tz,
        z + q.qw * tz + q.qx * ty - q.qy * tx,
    )


def _joined(outer: Place, inner: Place) -> Place:
    """Return the pose of `inner`, which is given in `outer`, in the parent of `outer`."""
    x, y, z = _rotated(outer, inner.x, inner.y, inner.z)
    a, b = outer, inner
    return Place(
        x + a.x,
        y + a.y,
        z + a.z,
        a.qw * b.qx + a.qx * b.qw + a.qy * b.qz - a.qz * b.qy,
        a.qw * b.qy - a.qx * b.qz + a.qy * b.qw + a.qz * b.qx,
        a.qw * b.qz + a.qx * b.qy - a.qy * b.qx + a.qz * b.qw,
        a.qw * b.qw - a.qx * b.qx - a.qy * b.qy - a.qz * b.qz,
    )


def _inverse(place: Place) -> Place:
    turned = Place(0, 0, 0, -place.qx, -place.qy, -place.qz, place.qw)
    x, y, z = _rotated(turned, place.x, place.y, place.z)
    return turned._replace(x=-x, y=-y, z=-z)


def _between(a: Place, b: Place, part: float) -> Place:
    """Interpolate: linear for the position, spherical for the rotation."""
    dot = a.qx * b.qx + a.qy * b.qy + a.qz * b.qz + a.qw * b.qw
    sign = -1.0 if dot < 0 else 1.0
    angle = math.acos(min(1.0, abs(dot)))
    if angle < 1e-6:
        first, second = 1 - part, sign * part
    else:
        first = math.sin((1 - part) * angle) / math.sin(angle)
        second = sign * math.sin(part * angle) / math.sin(angle)
    q = [first * i + second * j for i, j in zip(a[3:], b[3:], strict=True)]
    norm = math.hypot(*q)
    straight = [i + (j - i) * part for i, j in zip(a[:3], b[:3], strict=True)]
    return Place(*straight, *(i / norm for i in q))
