"""The configured motion limits, resolved for the paths that they match.

Each path is resolved once after a change of the configuration or the path: in steps in the
background, or immediately when the path is used, so that a limit is never applied late.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import structlog

from rcp_conditions import condition
from rcp_kernel.access.acl import Rights
from rcp_kernel.contract.identity import Grants
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Kind, Operation, Pattern, tenant_of
from rcp_kernel.safety.safe_value import safe_value
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_motion_limits.commanded_values import CommandedValues
from rcp_motion_limits.config import EnvelopeConfig, MotionLimitsConfig, patterns
from rcp_motion_limits.limit import MotionLimit
from rcp_motion_limits.narrowed import narrowed
from rcp_scheduling.turns import Work

__all__ = ["BoundPath", "MotionLimits"]

log = structlog.get_logger("rcp.envelopes")
_MAX_HELD = 1000  # cached sets of grants per path
_STEP = 8  # paths resolved per step
_COMMANDED = Operation.WRITE | Operation.EXECUTE


class BoundPath:
    """All motion limits of one path."""

    __slots__ = ("_held", "_schemas", "entry", "envelopes", "force", "period", "safe")

    def __init__(
        self, entry: Entry, envelopes: list[MotionLimit], force: CommandedValues, period: int
    ) -> None:
        self.entry = entry
        self.period = period
        """The period of `MotionLimits` in which `force` was recorded."""
        self.envelopes = envelopes
        self.force = force
        self.safe = safe_value(entry)
        self._held: dict[Grants, tuple[MotionLimit, ...]] = {}
        self._schemas: dict[Grants, dict[str, Any] | None] = {}

    @property
    def sensors(self) -> set[str]:
        """The sensors that limits of this path use."""
        places = (envelope.fence for envelope in self.envelopes)
        used = {place.sensor for place in places if place is not None}
        return {path for path in used | {one.pose for one in self.envelopes} if path is not None}

    def held(self, grants: Grants) -> tuple[MotionLimit, ...]:
        """Return the limits that apply to a principal: those of any of its roles here."""
        found = self._held.get(grants)
        if found is None:
            roles = {
                r for place, names in grants if place in ("*", self.entry.tenant) for r in names
            }
            found = tuple(
                e
                for e in self.envelopes
                if not e.table.roles or not roles.isdisjoint(e.table.roles)
            )
            if len(self._held) >= _MAX_HELD:
                self._held.clear()
            self._held[grants] = found
        return found

    def schema(self, grants: Grants) -> dict[str, Any] | None:
        """Return the schema of the values a principal may send; None if no bound narrows it."""
        if len(self._schemas) >= _MAX_HELD:
            self._schemas.clear()
        if grants not in self._schemas:
            held = [e for e in self.held(grants) if e.fault is None]
            bounds = [item for e in held for item in e.shown.items()]
            type_ = self.entry.input_type if _called(self.entry) else self.entry.value_type
            self._schemas[grants] = narrowed(type_.schema, bounds) if bounds else None
        return self._schemas[grants]

    def check(self, session: Session, value: Any) -> None:
        """Refuse a value that is not allowed now."""
        for envelope in self.held(session.principal.grants):
            envelope.check(session, value, self.force)

    def check_value(self, session: Session, value: Any) -> None:
        """Refuse a value, except a stop, that is not allowed in any state of the robot."""
        if self.safe is not None and value == self.safe:
            return
        for envelope in self.held(session.principal.grants):
            envelope.check_value(session, value)


class MotionLimits:
    """All motion limits of the gateway."""

    def __init__(self, host: FeatureHost) -> None:
        self._host = host
        self._now = host.clock.monotonic
        self._robots = host.robots
        self._tables: list[tuple[EnvelopeConfig, list[Pattern]]] = []
        self._bound: dict[str, BoundPath] = {}
        """By path; those in `_pending` may be outdated."""
        self._pending: dict[str, float] = {}
        """Paths to resolve, each with the time since which its limits apply."""
        self._working = False
        self._period = 0
        """Incremented when there are no limits, because commands are not tracked then."""
        self._faults: dict[str, list[str]] = {}
        self.drivers: dict[str, Session] = {}
        """The driver whose value is in force, by the path of the actuator."""
        self.on_bound: list[Callable[[str, BoundPath | None, BoundPath | None], None]] = []
        """Called with a path and its limits, before and after a change."""
        host.robots.follow(self._added, self._removed)

    def configure(self, config: MotionLimitsConfig) -> None:
        """Apply the limits of a configuration from now on."""
        tables = config.envelopes
        self._tables = [(table, patterns(table.paths)) for table in tables]
        conditions = [condition(table.when) for table in tables if table.when is not None]
        modes = [condition("mode")] if any(table.modes for table in tables) else []
        self._robots.conditions.use([*conditions, *modes])
        if not tables:
            self._period += 1
        paths = self._robots.entries if tables else self._bound
        self._pending = dict.fromkeys(paths, self._now())
        moving = {*self.drivers, *(command.path for command in self._host.control.running())}
        for path in moving & self._pending.keys():  # a fence may stop these at the next sample
            self._work_out(path)
        self._work()

    def of(self, path: str) -> BoundPath | None:
        """Return the limits of a path, if it has any."""
        if path in self._pending:
            self._work_out(path)
        return self._bound.get(path)

    def bound(self, path: str) -> BoundPath | None:
        """Return the limits that a path had when it was last resolved."""
        return self._bound.get(path)

    def applied(self, session: Session, entry: Entry) -> list[dict[str, Any]]:
        """List the limits that apply to a command of the session."""
        bound = self.of(entry.path)
        if bound is None:
            return []
        return [envelope.facts() for envelope in bound.held(session.principal.grants)]

    def describe(self, rights: Rights, entry: Entry, /, *, schemas: bool) -> dict[str, Any]:
        """Describe the limits that apply to a principal's commands, for the catalogue."""
        bound = self.of(entry.path)
        held = () if bound is None else bound.held(rights.grants)
        if bound is None or not held:
            return {}
        facts: dict[str, Any] = {"envelopes": [envelope.describe(rights) for envelope in held]}
        if schemas and (schema := bound.schema(rights.grants)) is not None:
            facts["command_schema"] = schema
        return facts

    def faults(self, rights: Rights | None) -> dict[str, list[str]]:
        """Return why limits do not fit, by path visible to `rights`.

        Commands to such a path are refused.
        """
        if rights is None or not self._faults:
            return dict(self._faults)
        every = "*" in rights.tenants
        return {
            path: why
            for path, why in self._faults.items()
            if (every or tenant_of(path) in rights.tenants) and rights.mask(path)
        }

    # -- resolving -----------------------------------------------------------------------------

    def _added(self, entry: Entry) -> None:
        if self._tables or entry.path in self._bound:
            self._pending[entry.path] = self._now()
            self._work()

    def _removed(self, entry: Entry) -> None:
        self._pending.pop(entry.path, None)
        self._faults.pop(entry.path, None)
        self._replace(entry.path, None)

    def _work(self) -> None:
        if self._pending and not self._working:
            self._working = True
            self._host.in_steps(self._work_out_all())

    def _work_out_all(self) -> Work:
        try:
            while self._pending:
                for number, path in enumerate(list(self._pending), 1):
                    if path in self._pending:
                        self._work_out(path)
                    if not number % _STEP:
                        yield
        finally:
            self._working = False

    def _work_out(self, path: str) -> None:
        entry = self._robots.entries.get(path)
        tables = self._matching(entry) if entry is not None else []
        old, faults = self._bound.get(path), self._faults.pop(path, None)
        new = None
        if entry is not None and tables:
            envelopes = [MotionLimit(table, entry, self._robots) for table in tables]
            if old is not None and old.entry is entry and old.period == self._period:
                force = old.force
            else:
                force = _first(entry, self._pending[path])
            new = BoundPath(entry, envelopes, force, self._period)
            found = [f"{e.table.name}: {e.fault}" for e in envelopes if e.fault is not None]
            if found:
                self._faults[path] = found
                if found != faults:
                    log.warning("envelope_does_not_fit", path=path, faults=found)
        self._replace(path, new)
        del self._pending[path]  # last: a path that could not be resolved is tried again when used

    def _matching(self, entry: Entry) -> list[EnvelopeConfig]:
        if not entry.operations & _COMMANDED or entry.tenant is None:
            return []
        path = entry.path
        return [t for t, wanted in self._tables if any(p.matches(path) for p in wanted)]

    def _replace(self, path: str, new: BoundPath | None) -> None:
        old = self._bound.pop(path, None)
        if new is not None:
            self._bound[path] = new
        else:
            self.drivers.pop(path, None)
        if old is not None or new is not None:
            for callback in self.on_bound:
                callback(path, old, new)


def _called(entry: Entry) -> bool:
    return entry.kind in (Kind.ACTION, Kind.SERVICE)


def _first(entry: Entry, since: float) -> CommandedValues:
    """Return the values that may be in force on a path that was not tracked before."""
    force = CommandedValues(entry.clock.monotonic)
    if (safe := safe_value(entry)) is not None:
        force.attempt(safe, since)
    if entry.latest is not None and entry.operations & Operation.WRITE:
        force.attempt(entry.latest.value, since)
    return force
