"""The recorder: starts and ends recordings, and passes commands and events to them."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterable
from typing import Any

import msgspec

from rcp_kernel.clock import iso
from rcp_kernel.contract.digest import LONGEST, bounded, hashed
from rcp_kernel.contract.events import Event
from rcp_kernel.errors import RcpError
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Pattern
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import ANY
from rcp_kernel.wire import NO_BODY, Request
from rcp_recorder.black_box import BlackBox
from rcp_recorder.config import RecorderConfig
from rcp_recorder.runs import ALWAYS, Run
from rcp_recorder.taps import SampleCounts, Taps
from rcp_recorder.writer import Writer

__all__ = ["PATH", "Recorder"]

PATH = "/system/recorder"
_TEXT = 500  # characters of a message
_SETTLE = 0.2  # s after which a change of state is looked at: others follow
_NAMED = re.compile(r"/tenant/[\w./-]*\w")
_ALWAYS = frozenset(("what", "outcome", "path", "command", "status", "time", "principal"))
"""What never mentions another path."""


class Recorder:
    """All recordings of a gateway; for the event loop's thread."""

    def __init__(self, config: RecorderConfig, host: FeatureHost, writer: Writer) -> None:
        self._config = config
        self._host = host
        self.writer = writer
        self.counts = SampleCounts()
        self.runs: dict[str, Run] = {}
        self.black_box: BlackBox | None = None
        if config.black_box is not None:
            self.black_box = BlackBox(config.black_box, host, writer, self.counts, config.sample_kb)
        self._always = self._make(ALWAYS, [Pattern(text) for text in config.paths])
        if config.paths:
            self.runs[ALWAYS] = self._always
        self._due: asyncio.TimerHandle | None = None

    # -- life ----------------------------------------------------------------------------------

    def open(self) -> None:
        """Begin to record."""
        self.writer.start()
        self._host.robots.follow(self._added, _ignore)
        self._host.robots.follow_state(self._state_changed)
        for entry in list(self._host.robots.entries.values()):
            self._added(entry)

    async def close(self) -> None:
        """End all recordings and complete their files."""
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
        self._host.changed(PATH)
        return run

    def stop(self, name: str) -> None:
        """End a recording."""
        if (run := self.runs.pop(name, None)) is not None:
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

    def _state_changed(self) -> None:
        if self._due is None:
            self._due = self._host.loop.call_later(_SETTLE, self._look)

    def _look(self) -> None:
        self._due = None
        for run in self.runs.values():
            run.describe()
        if self.black_box is not None:
            self.black_box.look()

    def heard(self, event: Event) -> None:
        """Record an event."""
        now = self._host.clock.now()
        if event.what == "estop":  # which has robots to halt first
            self._host.loop.call_soon(self._stopped, event, now)
            return
        path = event.path
        if path is None or event.touches is not None:
            return
        places = self._recording(path)
        if not places:
            return
        facts = _facts(event) | {"path": path}
        if event.request is not None and event.what == "write" and not event.hide:
            facts["value"] = _value(event.request)
        for tenant, taps in places:
            self._write(taps, "event", path, tenant, now, facts)

    def _stopped(self, event: Event, now: int) -> None:
        """Record an e-stop or its reset, wherever one of its robots is recorded."""
        robots = frozenset(event.facts.get("robots") or ())
        facts = _facts(event) | {"reset": bool(event.facts.get("reset"))}
        if isinstance(reason := event.facts.get("reason"), str):
            facts["reason"] = reason[:_TEXT]
        entries = self._host.robots.entries
        for tenant, taps in self._everywhere():
            recorded = (entry for path in taps.paths if (entry := entries.get(path)) is not None)
            if any(entry.unit.name in robots for entry in recorded):
                self._write(taps, "estop", None, tenant, now, facts)

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
            self._write(taps, "command", command.path, tenant, now, facts)

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

    def _write(
        self, taps: Taps, kind: str, path: str | None, tenant: str, now: int, facts: dict[str, Any]
    ) -> None:
        data = msgspec.json.encode(facts)
        # A message may mention what is not recorded, and what readers must not know of.
        if any(named not in taps for named in _NAMED.findall(data.decode())):
            data = msgspec.json.encode({key: facts[key] for key in _ALWAYS & facts.keys()})
        taps.note(kind, path, tenant, now, data)


def _facts(event: Event) -> dict[str, Any]:
    facts: dict[str, Any] = {"what": event.what, "outcome": event.outcome}
    if event.principal is not None:
        facts["principal"] = event.principal.name[:_TEXT]
    message = event.facts.get("message")
    if isinstance(message, str):
        facts["message"] = message[:_TEXT]
    return facts


def _value(request: Request) -> Any:
    if len(request.body) > LONGEST:
        return hashed(bytes(request.body))
    try:
        return bounded(request.decode_body(ANY))
    except RcpError:
        return None


def _ignore(_: object) -> None:
    """Go on: a resource that comes back is recorded again."""
