"""Watches where robots are while they are driven, and brings one to rest that leaves its fence.

It keeps every sensor running that an envelope asks for, so that its present value is known when a
command comes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import structlog

from rcp_kernel.model import Kind
from rcp_kernel.safety.motion_limits import MotionLimits
from rcp_kernel.safety.safety import Deadman
from rcp_kernel.sessions.command import CommandTable
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.store.audit import Audit
from rcp_kernel.streams.hub import Hub

if TYPE_CHECKING:
    from rcp_kernel.safety.motion_limits import Bound
    from rcp_kernel.sessions.session import Session
    from rcp_kernel.tree.samples import Sample

__all__ = ["FenceGuard"]

log = structlog.get_logger("rcp.envelopes")


class _Watcher:
    """Listens to one sensor for the paths that ask for it."""

    __slots__ = ("_guard", "bound")

    def __init__(self, guard: FenceGuard) -> None:
        self._guard = guard
        self.bound: list[Bound] = []

    def offer(self, sample: Sample) -> None:
        """Look whether the robot may go on."""
        for bound in self.bound:
            self._guard.look(bound, sample)


class FenceGuard:
    """Watches the sensors that say where what is driven is."""

    def __init__(
        self,
        limits: MotionLimits,
        hub: Hub,
        deadman: Deadman,
        commands: CommandTable,
        sessions: Sessions,
        audit: Audit,
    ) -> None:
        self._limits = limits
        self._drivers = limits.drivers
        self._hub = hub
        self._deadman = deadman
        self._commands = commands
        self._sessions = sessions
        self._audit = audit
        self._watchers: dict[str, _Watcher] = {}
        limits.on_bound.append(self._watch)
        self._watch()

    def _watch(self) -> None:
        """Listen to the sensors that are wanted from now on, each for what is bound to it."""
        entries, hub = self._hub.registry.entries, self._hub
        by_sensor: dict[str, list[Bound]] = {}
        for path, bound in self._limits.watched():
            by_sensor.setdefault(path, []).append(bound)
        for path in [path for path in self._watchers if path not in by_sensor]:
            watcher = self._watchers.pop(path)
            if (entry := entries.get(path)) is not None:
                hub.unlisten(entry, watcher)
        for path, several in by_sensor.items():
            watcher = self._watchers.setdefault(path, _Watcher(self))
            watcher.bound = several
            if (entry := entries.get(path)) is not None and watcher not in entry.listeners:
                hub.listen(entry, watcher)
        for path in [path for path in self._drivers if path not in self._limits.bound]:
            del self._drivers[path]

    def look(self, bound: Bound, sample: Sample) -> None:
        """Stop what drives a robot that is where its driver may not have it."""
        entry = bound.entry
        driver = self._drivers.get(entry.path)
        if driver is not None and (why := _trouble(bound, driver, sample)) is not None:
            self._drivers.pop(entry.path)
            self._deadman.stop(entry)
            self._tell(driver, bound, *why)
        elif entry.kind is Kind.ACTION:
            self._look_at_commands(bound, sample)

    def _look_at_commands(self, bound: Bound, sample: Sample) -> None:
        commands = self._commands
        for command in list(commands.running.values()):
            if command.path != bound.entry.path or command.asker is None or command.task is None:
                continue
            why = None if command.cancelling else _trouble(bound, command.asker, sample)
            if why is not None:
                self._tell(command.asker, bound, *why)
                commands.cancel(command, why[-1])

    def _tell(self, session: Session, bound: Bound, sensor: str, envelope: str, why: str) -> None:
        entry = bound.entry
        log.warning("fence_left", path=entry.path, envelope=envelope, sensor=sensor, reason=why)
        text = f"{entry.path} was stopped: {why}"
        facts = {"path": entry.path, "envelope": envelope, "message": text}
        self._sessions.tell(session.holder, "fence_left", **facts)
        self._audit.note(
            "fence",
            principal=session.principal,
            tenant=entry.tenant,
            path=entry.path,
            touches=(entry.path, sensor),
            outcome="stopped",
            session=session,
            envelope=envelope,
            reason=why,
        )


def _trouble(bound: Bound, driver: Session, sample: Sample) -> tuple[str, str, str] | None:
    """Return the sensor, the envelope that the robot has left, and how; or None."""
    for envelope in bound.held(driver.principal.grants):
        place = envelope.place
        if place is None or place.sensor != sample.entry.path:
            continue
        where = place.of_sample(sample)
        trouble = None if where is None else place.trouble(*where)
        if trouble is not None:
            return sample.entry.path, envelope.table.name, f"the robot {trouble[1]}{envelope.why}"
    return None
