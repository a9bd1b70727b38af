"""Recordings that are running: by configuration, or on request."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial

from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Pattern
from rcp_kernel.tree.entry import Entry
from rcp_recorder.channels import Stream
from rcp_recorder.facts import about, robot_path, robots_of
from rcp_recorder.taps import SampleCounts, Taps
from rcp_recorder.writer import Writer

__all__ = ["ALWAYS", "Run"]

ALWAYS = "always"


class Run:
    """One recording: in each tenant one sequence of files."""

    def __init__(
        self,
        name: str,
        patterns: Sequence[Pattern],
        host: FeatureHost,
        writer: Writer,
        counts: SampleCounts,
        longest: float,
    ) -> None:
        self.name = name
        self._patterns = patterns
        self._host = host
        self._writer = writer
        self._counts = counts
        self._longest = longest
        self.taps: dict[str, Taps] = {}
        """By tenant."""
        self._streams: dict[str, Stream] = {}
        self._facts = about(name, patterns)
        self._timer: asyncio.TimerHandle | None = None

    @property
    def paths(self) -> list[str]:
        """Every path that is recorded."""
        return [path for taps in self.taps.values() for path in taps.paths]

    def matches(self, path: str) -> bool:
        """Return whether it records a path."""
        return any(pattern.matches(path) for pattern in self._patterns)

    def add(self, entry: Entry) -> None:
        """Record a resource."""
        tenant = entry.tenant
        if tenant is None:
            return
        taps = self.taps.get(tenant)
        if taps is None:
            stream = self._streams[tenant] = Stream(self.name, tenant, self._facts)
            take = partial(self._writer.add, stream)
            taps = self.taps[tenant] = Taps(self._host, take, self._counts, self._longest)
        path, stream = robot_path(entry.unit), self._streams[tenant]
        if path not in stream.robots:
            stream.robots = {**stream.robots, **robots_of([entry.unit])}
        taps.add(entry)

    def remove(self, entry: Entry) -> None:
        """Take down that a resource is gone."""
        taps = self.taps.get(entry.tenant or "")
        if taps is not None:
            taps.remove(entry)

    def describe(self) -> None:
        """Take down what is known of the robots, for files that begin from now on."""
        for tenant, stream in self._streams.items():
            stream.robots = robots_of(self.taps[tenant].units)

    def end_after(self, seconds: float, ended: Callable[[], None]) -> None:
        """End it by itself."""
        self._timer = self._host.loop.call_later(seconds, ended)

    def end(self) -> None:
        """Forget when it would end by itself."""
        if self._timer is not None:
            self._timer.cancel()

    def close(self) -> None:
        """End it; the writer completes its files."""
        self.end()
        for tenant, taps in self.taps.items():
            taps.close()
            self._writer.end(self._streams[tenant])
        self.taps.clear()
