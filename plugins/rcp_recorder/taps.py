"""Taps on resources: each sample becomes one message for whoever wants it."""

from __future__ import annotations

from collections.abc import Callable

from rcp_kernel.errors import RcpError
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Operation
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample, Source
from rcp_kernel.values import Encoding
from rcp_recorder.channels import Channel, Message, note_channel, sample_channel

__all__ = ["SampleCounts", "Tap", "Taps"]

_JSON = Encoding.JSON
_KIB = 1024
Take = Callable[[Message], None]


class SampleCounts:
    """Samples that could not be recorded."""

    def __init__(self) -> None:
        self.long = 0
        """Longer than the limit."""
        self.invalid = 0
        """Not of their resource's type."""


class Tap:
    """One resource that is recorded."""

    def __init__(self, path: str, take: Take, counts: SampleCounts, longest: int) -> None:
        self.path = path
        self._take = take
        self._counts = counts
        self._longest = longest
        self._source: Source | None = None
        self._channel: Channel | None = None

    def offer(self, sample: Sample) -> None:
        """Take a sample as a message."""
        self.take(sample, sample.received)

    def take(self, sample: Sample, log_time: int) -> None:
        """Take a sample that is recorded at a time, which may be long after it was received."""
        native = sample.native
        if native is not None and len(native.data) > self._longest:
            self._counts.long += 1
            return
        try:
            data = sample.encoded(_JSON)  # shared with all subscribers in JSON
        except RcpError:
            self._counts.invalid += 1
            return
        if len(data) > self._longest:
            self._counts.long += 1
            return
        channel = self._channel
        if channel is None or sample.entry is not self._source:
            channel = self._describe(sample.entry)
        self._take(Message(channel, log_time, sample.timestamp, sample.seq, data))

    def _describe(self, source: Source) -> Channel:
        """Return the channel of a resource, which may have been declared again."""
        self._source = source
        fresh = sample_channel(source)
        known = self._channel
        if known is None or known.schema != fresh.schema:
            self._channel = known = fresh
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

    @property
    def paths(self) -> list[str]:
        """Every path that is recorded."""
        return list(self._ends)

    def __contains__(self, path: str) -> bool:
        return path in self._ends

    def add(self, entry: Entry) -> None:
        """Record a resource: its samples if it has some, commands and events."""
        if entry.path in self._ends:
            return
        if not entry.operations & Operation.SUBSCRIBE:
            self._ends[entry.path] = _nothing
            return
        tap = Tap(entry.path, self._take, self._counts, self._longest)
        self._ends[entry.path] = self._host.robots.watch(entry.path, tap.offer)
        if entry.latest is not None:  # what does not change is known, too
            tap.take(entry.latest, self._host.clock.now())

    def note(self, kind: str, path: str | None, tenant: str, moment: int, data: bytes) -> None:
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


def _nothing() -> None:
    """End nothing."""
