"""`/diagnostics`: each status as a sensor, each change of level as an event."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import msgspec

from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.model import Resource
from rcp_ros2.binding import Binding, Offer, Shared, common
from rcp_ros2.config import Mapping, Ros2Config
from rcp_ros2.graph import Graph
from rcp_ros2.names import absolute, legal

__all__ = ["ARRAY", "Diagnostics"]

ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
Level = Literal["ok", "warn", "error", "stale"]
_LEVELS: tuple[Level, ...] = ("ok", "warn", "error", "stale")
_USUAL = ("diagnostics", "diagnostics_agg")
"""The names that these topics have by convention."""
_NO_HARDWARE = ("", "none")
_MOST = 1000  # statuses per topic; names that change with every message would fill the tree


class Diagnosis(msgspec.Struct, frozen=True):
    """The status of a component."""

    level: Level
    name: str
    message: str
    hardware_id: str
    values: dict[str, str]


class DiagnosisChange(msgspec.Struct, frozen=True):
    """A component whose level has changed."""

    path: str
    """Path of the status resource below the robot."""
    was: Level | None
    """None: first report."""
    now: Diagnosis


@dataclass(slots=True)
class _Status:
    path: str
    diagnosis: Diagnosis
    stamp: int | None
    updated_at: float
    """Monotonic time, s."""


class Diagnostics:
    """Finds the exposed diagnostics topics and the statuses on them."""

    def __init__(self, shared: Shared, exposes: Callable[[str], bool]) -> None:
        self._shared = shared
        self._exposes = exposes
        self._boards: dict[str, _Board] = {}
        self._named = _named(shared.config)

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return an event for each topic and a sensor for each of its statuses."""
        found: dict[str, Offer] = {}
        topics = {name for name, type_ in graph.topics.items() if type_ == ARRAY}
        topics |= self._named - graph.topics.keys()
        for topic in sorted(topics - self._boards.keys()):
            if self._exposes(topic):
                self._boards[topic] = _Board(self._shared, topic)
        for board in self._boards.values():
            board.sweep()
            found |= board.offers()
        return found

    def hardware(self, space: str) -> frozenset[str]:
        """Return the ids of the hardware that the statuses of a namespace tell."""
        boards = (b for t, b in self._boards.items() if t.rpartition("/")[0] == space)
        ids = (s.diagnosis.hardware_id for board in boards for s in board.statuses.values())
        return frozenset(id_ for id_ in ids if id_.lower() not in _NO_HARDWARE)


def _named(config: Ros2Config) -> frozenset[str]:
    """Return the topics that are named, not matched: they are offered before anybody publishes them."""
    if config.robots:  # not before a robot is there
        return frozenset()
    names = (absolute(name, config.namespace) for name in config.expose if "*" not in name)
    return frozenset(name for name in names if name.rpartition("/")[2] in _USUAL)


class _Board:
    """The statuses of one topic; used on the event loop."""

    def __init__(self, shared: Shared, topic: str) -> None:
        self.shared = shared
        self.topic = topic
        self.event = shared.naming.path("event", topic)
        self.statuses: dict[str, _Status] = {}
        self._paths: set[str] = set()
        self._early: list[DiagnosisChange] | None = []
        """Changes that occurred before the event was declared."""
        self._mapping = Mapping(topic=topic)
        self._offers = {self.event: Offer(self._mapping, self._change)}
        shared.ros.post(shared.listen, topic, ARRAY, f"{topic} statuses", self._on_array)

    def offers(self) -> dict[str, Offer]:
        """Return the paths of the statuses received so far."""
        return self._offers

    def _change(self) -> Binding:
        return Changes(self, self.event, self._mapping)

    def _on_array(self, array: Any) -> None:
        stamp = array.header.stamp.sec * 1_000_000_000 + array.header.stamp.nanosec
        found = [_diagnosis(status) for status in array.status]
        self.shared.host.call_soon(self._take, found, stamp if stamp > 0 else None)

    def _take(self, found: list[Diagnosis], stamp: int | None) -> None:
        fresh = False
        for diagnosis in found:
            status = self.statuses.get(diagnosis.name)
            if status is None:
                if len(self.statuses) >= _MOST:
                    continue
                status = self._new(diagnosis, stamp)
                fresh = True
                self._changed(status, None)
            else:
                was, status.diagnosis = status.diagnosis.level, diagnosis
                status.stamp, status.updated_at = stamp, time.monotonic()
                self._publish(status, was)
        if fresh:
            self._full()
            self.shared.refresh()

    def _full(self) -> None:
        text = f"{self.topic} has more than {_MOST} statuses: the others are ignored"
        self.shared.trouble(f"{self.topic} full", text if len(self.statuses) >= _MOST else None)

    def _new(self, diagnosis: Diagnosis, stamp: int | None) -> _Status:
        name = legal(diagnosis.name, self._paths)
        self._paths.add(name)
        path = f"{self.shared.naming.path('sensor', self.topic)}/{name}"
        status = _Status(path, diagnosis, stamp, time.monotonic())
        self.statuses[diagnosis.name] = status
        make = partial(StatusOf, self, status, self._mapping)
        self._offers[path] = Offer(self._mapping, make)
        return status

    def _publish(self, status: _Status, was: Level) -> None:
        self.shared.host.publish(status.path, status.diagnosis, status.stamp)
        if status.diagnosis.level != was:
            self._changed(status, was)

    def _changed(self, status: _Status, was: Level | None) -> None:
        if was is None and status.diagnosis.level == "ok":
            return
        change = DiagnosisChange(f"/{status.path}", was, status.diagnosis)
        if self._early is not None:
            self._early.append(change)
        else:
            self.shared.host.publish(self.event, change, status.stamp)

    def placed(self) -> None:
        """Publish changes that occurred before the event was declared."""
        early, self._early = self._early, None
        for change in early or ():
            self.shared.host.publish(self.event, change)

    def sweep(self) -> None:
        """Mark statuses that have not been updated as stale."""
        limit = self.shared.config.diagnostics.stale
        oldest = time.monotonic() - limit
        for status in self.statuses.values():
            was = status.diagnosis.level
            if status.updated_at < oldest and was != "stale":
                text = f"no update for {limit:g} s; it was {was}"
                text = f"{text}: {status.diagnosis.message}" if status.diagnosis.message else text
                status.diagnosis = msgspec.structs.replace(
                    status.diagnosis, level="stale", message=text
                )
                status.stamp = None
                self._publish(status, was)


def _diagnosis(status: Any) -> Diagnosis:
    level: Level = _LEVELS[status.level] if status.level < len(_LEVELS) else "error"
    values = {pair.key: pair.value for pair in status.values}
    return Diagnosis(level, status.name, status.message, status.hardware_id, values)


class StatusOf(Binding):
    """One status."""

    def __init__(self, board: _Board, status: _Status, mapping: Mapping) -> None:
        self._status = status
        facts = common(
            status.path,
            mapping,
            f"Diagnostics of {status.diagnosis.name or 'an unnamed component'}.",
            topic=board.topic,
            status=status.diagnosis.name,
            hardware_id=status.diagnosis.hardware_id or None,
        )
        super().__init__(board.shared, Resource(value=Diagnosis, live=True, **facts), mapping)

    async def read(self) -> Any:
        """Return the latest status."""
        return self._status.diagnosis

    def placed(self) -> None:
        """Publish the message in which the status first appeared."""
        status = self._status
        self.shared.host.publish(status.path, status.diagnosis, status.stamp)


class Changes(Binding):
    """The event of level changes on one topic."""

    def __init__(self, board: _Board, name: str, mapping: Mapping) -> None:
        text = f"A status on {board.topic} changed its level, or was not OK in its first report."
        facts = common(name, mapping, text, topic=board.topic)
        super().__init__(board.shared, Resource(value=DiagnosisChange, live=True, **facts), mapping)
        self.placed = board.placed

    async def read(self) -> Any:
        """Raise: nothing has changed yet, or the kernel would have returned the last change."""
        raise AdapterUnavailable(
            "no status has changed its level so far",
            remedy="Subscribe to it to receive the next one.",
        )
