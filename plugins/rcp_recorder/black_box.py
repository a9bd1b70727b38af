"""The black box: the last seconds of each robot in memory, written when something happens to it."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Literal

from rcp_kernel.clock import iso
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Pattern
from rcp_kernel.tree.entry import Entry, RobotUnit
from rcp_recorder.channels import Message, Stream
from rcp_recorder.config import BlackBoxConfig
from rcp_recorder.facts import about, robot_path, robots_of
from rcp_recorder.kept import INCIDENT
from rcp_recorder.notes import shortened
from rcp_recorder.notices import Notices
from rcp_recorder.taps import SampleCounts, Taps
from rcp_recorder.writer import MB, OVERHEAD, Writer

__all__ = ["BlackBox"]

_NS = 1_000_000_000
_State = Literal["ready", "fault", "lost"]


class Box:
    """The memory of one robot."""

    def __init__(self, robot: str, tenant: str, config: BlackBoxConfig, writer: Writer) -> None:
        self.robot = robot
        self.tenant = tenant
        self._writer = writer
        self._span = int(config.seconds * _NS)
        self._limit = int(config.mb * MB)
        self._kept: deque[Message] = deque()
        self._size = 0
        self._stream: Stream | None = None
        self._timer: asyncio.TimerHandle | None = None

    @property
    def active(self) -> bool:
        """Whether an incident is being recorded."""
        return self._stream is not None

    def take(self, message: Message) -> None:
        """Keep a message, or write it to the incident."""
        if self._stream is not None:
            self._writer.add(self._stream, message)
            return
        kept, size = self._kept, self._size + len(message[4]) + OVERHEAD
        kept.append(message)
        oldest = message[1] - self._span
        while kept and (size > self._limit or kept[0][1] < oldest):
            size -= len(kept.popleft()[4]) + OVERHEAD
        self._size = size

    def write(self, stream: Stream, loop: asyncio.AbstractEventLoop, after: float) -> None:
        """Write what is kept and what follows."""
        self._stream = stream
        kept, size = list(self._kept), self._size
        self._kept.clear()
        self._size = 0
        if kept:
            self._writer.add_all(stream, kept, size)
        self._timer = loop.call_later(after, self.close)

    def close(self) -> None:
        """End the incident."""
        if self._timer is not None:
            self._timer.cancel()
        if self._stream is not None:
            self._writer.end(self._stream)
            self._stream = None


class _Robot:
    """A robot with its memory, and what is taken from it."""

    def __init__(self, box: Box, taps: Taps) -> None:
        self.box = box
        self.taps = taps
        self.units: dict[RobotUnit, _State] = {}


class BlackBox:
    """The memory of all robots."""

    def __init__(
        self,
        config: BlackBoxConfig,
        host: FeatureHost,
        writer: Writer,
        counts: SampleCounts,
        longest: float,
        notices: Notices,
    ) -> None:
        self._config = config
        self._patterns = [Pattern(text) for text in config.paths]
        self._host = host
        self._writer = writer
        self._counts = counts
        self._longest = longest
        self._notices = notices
        self._robots: dict[str, _Robot] = {}

    def add(self, entry: Entry) -> None:
        """Keep the samples of a resource."""
        tenant, unit = entry.tenant, entry.unit
        if tenant is None or not any(p.matches(entry.path) for p in self._patterns):
            return
        path = robot_path(unit)
        robot = self._robots.get(path)
        if robot is None:
            box = Box(path, tenant, self._config, self._writer)
            taps = Taps(self._host, box.take, self._counts, self._longest)
            robot = self._robots[path] = _Robot(box, taps)
        robot.units.setdefault(unit, "ready")
        robot.taps.add(entry)

    def remove(self, entry: Entry) -> None:
        """Take down that a resource is gone."""
        if (robot := self._robots.get(robot_path(entry.unit))) is not None:
            robot.taps.remove(entry)

    def places(self) -> list[tuple[str, Taps]]:
        """List what is recorded, with its tenant."""
        return [(robot.box.tenant, robot.taps) for robot in self._robots.values()]

    def taps_of(self, entry: Entry) -> Taps | None:
        """Return what is recorded of the robot of a resource."""
        robot = self._robots.get(robot_path(entry.unit))
        return None if robot is None else robot.taps

    def stopped(self, paths: frozenset[str], reason: str) -> None:
        """Write the robots that an e-stop has halted."""
        for robot in self._robots.values():
            if not paths.isdisjoint(robot.taps.paths):
                self._write(robot, reason)

    def look(self) -> None:
        """Write the robots whose link is lost, or that have a fault, since the last look."""
        for robot in self._robots.values():
            for unit, before in robot.units.items():
                state = _state(unit, before)
                robot.units[unit] = state
                if state in (before, "ready"):
                    continue
                what = "link lost" if state == "lost" else "fault"
                self._write(robot, f"{what}: {unit.detail}" if unit.detail else what)

    def record(self, robot: str, reason: str) -> bool:
        """Write a robot by its path, for another feature; return whether anything of it is kept."""
        found = self._robots.get(robot)
        if found is None:
            return False
        self._write(found, reason)
        return True

    def close(self) -> None:
        """End all."""
        for robot in self._robots.values():
            robot.taps.close()
            robot.box.close()
        self._robots.clear()

    def _write(self, robot: _Robot, reason: str) -> None:
        """Begin an incident; what happens during one is a part of it."""
        if robot.box.active:
            return
        box, reason = robot.box, shortened(reason)
        self._notices.incident(robot.taps, box.tenant, box.robot, reason)
        at = iso(self._host.clock.now())
        facts = about(INCIDENT, self._patterns, reason=reason, robot=box.robot, at=at)
        stream = Stream(INCIDENT, box.tenant, facts)
        stream.robots = robots_of(robot.taps.units)
        box.write(stream, self._host.loop, self._config.after)


def _state(unit: RobotUnit, before: _State) -> _State:
    match unit.availability:
        case "ready":
            return "ready"
        case "degraded":
            return "fault"
        case "down":
            return "lost"
        case _:  # it is being opened
            return before
