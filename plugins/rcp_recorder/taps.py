"""Taps on resources: each sample becomes one message for whoever wants it."""

from __future__ import annotations

from collections.abc import Callable

from rcp_kernel.errors import RcpError
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Operation
from rcp_kernel.tree.entry import Entry, RobotUnit
from rcp_kernel.tree.samples import Sample, Source
from rcp_recorder.channels import Channel, Message, note_channel
from rcp_recorder.sample_channels import SampleChannels
from rcp_recordings.names import MessageKind

__all__ = ["SampleCounts", "Tap", "Taps"]

_KIB = 1024
Take = Callable[[Message], None]


class SampleCounts:
    """Samples that could not be recorded."""

    def __init__(self) -> None:
        self.long = 0
        """Longer than the limit."""
        self.invalid = 0
        """Not of their resource's type."""
        self.notices = 0
        """Not samples: what was told of robots, too much at once."""


class Tap:
    """One resource that is recorded."""

    def __init__(
        self, path: str, take: Take, counts: SampleCounts, longest: int, topics: dict[str, str]
    ) -> None:
        self.path = path
        self._take = take
        self._counts = counts
        self._longest = longest
        self._topics = topics
        """By ROS topic, the path that it is recorded of: others have only their part of it."""
        self._channels: SampleChannels | None = None
        self._native = False

    def offer(self, sample: Sample) -> None:
        """Take a sample as a message."""
        self.take(sample, sample.received)

    def take(self, sample: Sample, log_time: int) -> None:
        """Take a sample that is recorded at a time, which may be long after it was received."""
        native = sample.native
        if native is not None and len(native.data) > self._longest:
            self._counts.long += 1
            return
        channels = self._channels
        if channels is None or sample.entry is not channels.entry:
            channels = self._describe(sample.entry)
        try:
            messages = channels.messages(sample, log_time, native=self._native)
        except RcpError:
            self._counts.invalid += 1
            return
        for message in messages:
            if len(message.data) > self._longest:
                self._counts.long += 1
            else:
                self._take(message)

    def _describe(self, source: Source) -> SampleChannels:
        """Return the channels of a resource, which may have been declared again."""
        assert isinstance(source, Entry)  # of the registry
        known = self._channels
        if known is not None and known.same(source):
            known.entry = source
            return known
        self._channels = known = SampleChannels(source)
        if known.topic is not None:
            self._native = self._topics.setdefault(known.topic, self.path) == self.path
        return known


class Taps:
    """The resources that one recording consists of, in one tenant."""

    def __init__(self, host: FeatureHost, take: Take, counts: SampleCounts, longest: float) -> None:
        self._host = host
        self._take = take
        self._counts = counts
        self._longest = int(longest * _KIB)
        self._ends: dict[str, Callable[[], None]] = {}
        self._notes: dict[tuple[str, str | None], Channel] = {}
        self._topics: dict[str, str] = {}
        self.units: dict[RobotUnit, dict[str, bool]] = {}
        """The robots of which something is recorded, with the paths of each, and whether they are there now."""

    @property
    def paths(self) -> list[str]:
        """Every path that is recorded."""
        return list(self._ends)

    def __contains__(self, path: str) -> bool:
        return path in self._ends

    def add(self, entry: Entry) -> None:
        """Record a resource: its samples if it has some, commands and events."""
        self.units.setdefault(entry.unit, {})[entry.path] = True
        if entry.path in self._ends:
            return
        if not entry.operations & Operation.SUBSCRIBE:
            self._ends[entry.path] = _nothing
            return
        tap = Tap(entry.path, self._take, self._counts, self._longest, self._topics)
        self._ends[entry.path] = self._host.robots.watch(entry.path, tap.offer)
        if entry.latest is not None:  # what does not change is known, too
            tap.take(entry.latest, self._host.clock.now())

    def remove(self, entry: Entry) -> None:
        """Take down that a resource is gone; one that comes back is recorded again."""
        paths = self.units.get(entry.unit, {})
        if entry.path in paths:
            paths[entry.path] = False

    def note(
        self, kind: MessageKind, path: str | None, tenant: str, moment: int, data: bytes
    ) -> None:
        """Take a command or an event."""
        channel = self._notes.get((kind, path))
        if channel is None:
            channel = self._notes[kind, path] = note_channel(kind, path, tenant)
        self._take(Message(channel, moment, moment, 0, data))

    def close(self) -> None:
        """End all."""
        for end in self._ends.values():
            end()
        self._ends.clear()
        self.units.clear()


def _nothing() -> None:
    """End nothing."""
