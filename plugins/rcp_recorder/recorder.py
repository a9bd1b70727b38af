"""The recorder: starts and ends recordings, and passes commands and events to them."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterable
from typing import Any

from rcp_kernel.clock import iso
from rcp_kernel.contract.digest import bounded
from rcp_kernel.contract.events import Event
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Pattern
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import NO_BODY
from rcp_recorder.black_box import BlackBox
from rcp_recorder.config import RecorderConfig
from rcp_recorder.notes import described, value_of, write
from rcp_recorder.notices import ROBOT_EVENTS, Notices
from rcp_recorder.runs import ALWAYS, Run
from rcp_recorder.taps import SampleCounts, Taps
from rcp_recorder.writer import Writer
from rcp_scheduling.turns import Work, at_once

__all__ = ["PATH", "Recorder"]

PATH = "/system/recorder"
_SETTLE = 0.2  # s after which a change of state is looked at: others follow


class Recorder:
    """All recordings of a gateway; for the event loop's thread."""

    def __init__(self, config: RecorderConfig, host: FeatureHost, writer: Writer) -> None:
        self._config = config
        self._host = host
        self.writer = writer
        self.counts = SampleCounts()
        self._notices = Notices(host, self.counts)
        self.runs: dict[str, Run] = {}
        self.black_box: BlackBox | None = None
        if config.black_box is not None:
            self.black_box = BlackBox(
                config.black_box, host, writer, self.counts, config.sample_kb, self._notices
            )
        self._always = self._make(ALWAYS, [Pattern(text) for text in config.paths])
        if config.paths:
            self.runs[ALWAYS] = self._always
        self._due: asyncio.TimerHandle | None = None
        self._changed = False
        self._jobs: deque[Work] = deque()
        """What is done in steps, one after the other."""
        self._working: Work | None = None

    # -- life ----------------------------------------------------------------------------------

    def open(self) -> None:
        """Begin to record."""
        self.writer.start()
        self._host.robots.follow(self._added, self._removed)
        self._host.robots.follow_state(self._state_changed)
        for entry in list(self._host.robots.entries.values()):
            self._added(entry)

    async def close(self) -> None:
        """End all recordings and complete their files."""
        self._jobs.append(self._notices.steps(self._everywhere(), states=False))
        at_once(self._working or self._work())
        if self._due is not None:
            self._due.cancel()
        if self.black_box is not None:
            self.black_box.close()
        for run in self.runs.values():
            run.close()
        self.runs.clear()
        await asyncio.to_thread(self.writer.close)

    def start(self, name: str, patterns: list[Pattern], entries: Iterable[Entry]) -> Run:
        """Start a recording of some resources."""
        run = self.runs[name] = self._make(name, patterns)
        for entry in entries:
            run.add(entry)
        run.describe()
        self._state_changed()
        self._host.changed(PATH)
        return run

    def stop(self, name: str) -> None:
        """End a recording."""
        if name in self.runs:
            run = self.runs.pop(name)
            run.end()
            self._do(self._ending(run, [*self._everywhere(), *run.taps.items()]))

    def _ending(self, run: Run, places: list[tuple[str, Taps]]) -> Work:
        """End a recording, once it has what was told until now."""
        yield from self._notices.steps(places, states=False)
        run.close()
        self._host.changed(PATH)

    def _make(self, name: str, patterns: list[Pattern]) -> Run:
        return Run(name, patterns, self._host, self.writer, self.counts, self._config.sample_kb)

    # -- what happens --------------------------------------------------------------------------

    def _added(self, entry: Entry) -> None:
        if ALWAYS in self.runs and self._always.matches(entry.path):
            self._always.add(entry)
        if self.black_box is not None:
            self.black_box.add(entry)
        self._state_changed()

    def _removed(self, entry: Entry) -> None:
        for run in self.runs.values():
            run.remove(entry)
        if self.black_box is not None:
            self.black_box.remove(entry)
        self._state_changed()

    def _state_changed(self) -> None:
        self._changed = True
        if self._due is None:
            self._due = self._host.loop.call_later(_SETTLE, self._look)

    def _look(self) -> None:
        self._do(self._looking())

    def _looking(self) -> Work:
        """Look at everything; only one look at a time is due, or waits, or goes on."""
        self._changed = False
        try:
            for run in list(self.runs.values()):
                run.describe()
                yield
            yield from self._notices.steps(self._everywhere())
            if self.black_box is not None:
                self.black_box.look()
        finally:
            self._due = None
        if self._changed:
            self._state_changed()

    def _do(self, job: Work) -> None:
        """Do something in steps, after what was begun before."""
        self._jobs.append(job)
        if self._working is None:
            self._working = self._work()
            self._host.in_steps(self._working)

    def _work(self) -> Work:
        try:
            while self._jobs:
                yield from self._jobs.popleft()
                yield
        finally:
            self._working = None

    def heard(self, event: Event) -> None:
        """Record an event; in the next turn, for robots that are to be halted come first."""
        now = self._host.clock.now()
        if event.what == "estop":
            self._host.loop.call_soon(self._stopped, event, now)
        elif event.what in ROBOT_EVENTS:
            self._notices.heard(event, now)
            self._state_changed()
        elif event.path is not None:
            self._happened(event, event.path, now)

    def _happened(self, event: Event, path: str, now: int) -> None:
        places = self._recording(path)
        if not places:
            return
        facts = described(event) | {"path": path}
        if event.request is not None and event.what == "write" and not event.hide:
            facts["value"] = value_of(event.request)
        touches = tuple(event.touches or ())
        for tenant, taps in places:
            write(taps, "event", path, tenant, now, facts, touches)

    def _stopped(self, event: Event, now: int) -> None:
        """Record an e-stop or its reset, wherever one of its robots is recorded."""
        robots = frozenset(event.facts.get("robots") or ())
        facts = described(event) | {"reset": bool(event.facts.get("reset"))}
        for tenant, taps in self._everywhere():
            if any(unit.name in robots for unit in taps.units):
                write(taps, "estop", None, tenant, now, facts)

    def followed(self, command: Command, step: Record) -> None:
        """Record a step of a command."""
        places = self._recording(command.path)
        if not places:
            return
        facts: dict[str, Any] = {
            "time": iso(step.time),
            "command": command.id,
            "path": command.path,
            "status": step.status,
            "principal": command.principal,
        }
        if step.status == "accepted" and command.input is not None:
            facts["input"] = bounded(command.input)
        if step.body is not NO_BODY:
            facts["body"] = bounded(step.body)
        for key in ("progress", "message", "error"):
            if (value := getattr(step, key)) is not None:
                facts[key] = value
        now = self._host.clock.now()
        for tenant, taps in places:
            write(taps, "command", command.path, tenant, now, facts)

    def halted(self, paths: frozenset[str], by: str, reason: str) -> None:
        """Let the black box write, once the robots are halted."""
        if self.black_box is not None:
            self._host.loop.call_soon(self.black_box.stopped, paths, f"e-stop by {by}: {reason}")

    # -- where it goes -------------------------------------------------------------------------

    def _everywhere(self) -> list[tuple[str, Taps]]:
        found = [place for run in self.runs.values() for place in run.taps.items()]
        return found if self.black_box is None else found + self.black_box.places()

    def _recording(self, path: str) -> list[tuple[str, Taps]]:
        """List where a resource is recorded; called for each event and step of a command."""
        entry = self._host.robots.entries.get(path)
        if entry is None or entry.tenant is None:
            return []
        places = [run.taps.get(entry.tenant) for run in self.runs.values()]
        if self.black_box is not None:
            places.append(self.black_box.taps_of(entry))
        return [(entry.tenant, taps) for taps in places if taps is not None and path in taps]
