"""The envelopes of the configuration, bound to the paths that they match.

Bound anew when the configuration or a path changes, and worked out once for each path and set of
grants: a command on a path without an envelope costs one dictionary access.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import structlog

from rcp_conditions import condition
from rcp_kernel.access.acl import Rights
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.config.envelopes import EnvelopeConfig, patterns
from rcp_kernel.contract.identity import Grants
from rcp_kernel.model import Kind, Operation, Pattern, tenant_of
from rcp_kernel.safety.commanded_values import CommandedValues
from rcp_kernel.safety.motion_limit import MotionLimit
from rcp_kernel.safety.narrowed import narrowed
from rcp_kernel.safety.safety import safe_value
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry

__all__ = ["Bound", "MotionLimits"]

log = structlog.get_logger("rcp.envelopes")
_MAX_HELD = 1000  # sets of grants that a path remembers
_COMMANDED = Operation.WRITE | Operation.EXECUTE


class Bound:
    """Every envelope of one path."""

    __slots__ = ("_held", "_told", "entry", "envelopes", "force", "safe")

    def __init__(self, entry: Entry, envelopes: list[MotionLimit], force: CommandedValues) -> None:
        self.entry = entry
        self.envelopes = envelopes
        self.force = force
        self.safe = safe_value(entry)
        self._held: dict[Grants, tuple[MotionLimit, ...]] = {}
        self._told: dict[Grants, dict[str, Any] | None] = {}

    def held(self, grants: Grants) -> tuple[MotionLimit, ...]:
        """Return those to which a principal is held: any that names one of its roles here."""
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
        """Return the schema of what a principal may send, or None if no bound narrows it."""
        if len(self._told) >= _MAX_HELD:
            self._told.clear()
        if grants not in self._told:
            held = [e for e in self.held(grants) if e.fault is None]
            bounds = [item for e in held for item in e.table.bounds.items()]
            type_ = self.entry.input_type if _called(self.entry) else self.entry.value_type
            self._told[grants] = narrowed(type_.schema, bounds) if bounds else None
        return self._told[grants]

    def check(self, session: Session, value: Any) -> None:
        """Refuse a value that may not reach the robot; bringing it to rest is never refused."""
        if self.safe is not None and value == self.safe:
            return
        for envelope in self.held(session.principal.grants):
            envelope.check(session, value, self.force)

    def check_value(self, session: Session, value: Any) -> None:
        """Refuse a value that may not reach the robot in any state of it."""
        if self.safe is not None and value == self.safe:
            return
        for envelope in self.held(session.principal.grants):
            envelope.check_value(session, value)


class MotionLimits:
    """Every envelope of the gateway."""

    def __init__(
        self, registry: Registry, conditions: Conditions, tables: Sequence[EnvelopeConfig]
    ) -> None:
        self._registry = registry
        self._conditions = conditions
        self._tables: list[tuple[EnvelopeConfig, list[Pattern]]] = []
        self.bound: dict[str, Bound] = {}
        """By path."""
        self._faults: dict[str, list[str]] = {}
        self.drivers: dict[str, Session] = {}
        """Whose value is in force, by the path of the actuator."""
        self.on_bound: list[Callable[[], None]] = []
        """Called when envelopes were bound anew."""
        registry.on_added.append(self._added)
        registry.on_removed.append(self._removed)
        self.configure(tables)

    def configure(self, tables: Sequence[EnvelopeConfig]) -> None:
        """Take over the envelopes of a configuration; they count from now on."""
        self._tables = [(table, patterns(table.paths)) for table in tables]
        asked = [condition(table.when) for table in tables if table.when is not None]
        modes = [condition("mode")] if any(table.modes for table in tables) else []
        self._conditions.use("envelopes", [*asked, *modes])
        for entry in self._registry.entries.values():
            self._bind(entry)
        self._tend()

    def check(self, session: Session, entry: Entry, value: Any) -> None:
        """Refuse a value outside an envelope, as `Envelope.check` does."""
        bound = self.bound.get(entry.path)
        if bound is not None:
            bound.check(session, value)

    def check_later(self, session: Session, entry: Entry, value: Any) -> None:
        """Refuse a value that could not be sent later either, as `Envelope.check_value` does."""
        bound = self.bound.get(entry.path)
        if bound is not None:
            bound.check_value(session, value)

    def send(self, session: Session, entry: Entry, value: Any) -> None:
        """Check a value that goes to the robot right now, and note that it does."""
        bound = self.bound.get(entry.path)
        if bound is None:
            return
        bound.check(session, value)
        bound.force.attempt(value)
        if _called(entry):
            bound.force.settle(value, value)
        else:
            self._drives(session, bound, value)

    def _drives(self, session: Session, bound: Bound, value: Any) -> None:
        """Note whose value goes to an actuator that can be brought to rest."""
        if bound.safe is None or value == bound.safe:
            self.drivers.pop(bound.entry.path, None)
        else:
            self.drivers[bound.entry.path] = session

    def took(self, entry: Entry, value: Any, actual: Any) -> None:
        """Note that the robot took what was sent, as `actual`."""
        bound = self.bound.get(entry.path)
        if bound is not None:
            bound.force.settle(value, actual)

    def refused(self, entry: Entry, value: Any) -> None:
        """Note that the robot did not take what was sent and goes on as before."""
        bound = self.bound.get(entry.path)
        if bound is not None:
            bound.force.withdraw(value)

    def note_stop(self, entry: Entry, safe: Any) -> None:
        """Note that a safe value is on its way."""
        bound = self.bound.get(entry.path)
        if bound is not None:
            bound.force.attempt(safe)

    def note_rest(self, entry: Entry, safe: Any) -> None:
        """Note that a safe value is in force, or the robot is brought to rest as a whole."""
        bound = self.bound.get(entry.path)
        if bound is not None:
            bound.force.rest(safe)
            self.drivers.pop(entry.path, None)

    def applied(self, session: Session, entry: Entry) -> list[dict[str, Any]]:
        """List the envelopes that a command of the session has to stay in."""
        bound = self.bound.get(entry.path)
        if bound is None:
            return []
        return [envelope.facts() for envelope in bound.held(session.principal.grants)]

    def told(self, rights: Rights, entry: Entry, *, schemas: bool) -> dict[str, Any]:
        """Describe the envelopes to which a principal's commands are held, for the catalogue."""
        bound = self.bound.get(entry.path)
        held = () if bound is None else bound.held(rights.grants)
        if bound is None or not held:
            return {}
        facts: dict[str, Any] = {"envelopes": [envelope.told(rights) for envelope in held]}
        if schemas and (schema := bound.schema(rights.grants)) is not None:
            facts["command_schema"] = schema
        return facts

    def faults_in(self, tenants: tuple[str, ...]) -> dict[str, list[str]]:
        """Return, by path, why an envelope does not fit it, so that it lets nothing through."""
        return {
            path: list(why)
            for path, why in self._faults.items()
            if "*" in tenants or tenant_of(path) in tenants
        }

    # -- binding -------------------------------------------------------------------------------

    def _added(self, entry: Entry) -> None:
        self._bind(entry)
        self._tend()

    def _removed(self, entry: Entry) -> None:
        self.bound.pop(entry.path, None)
        self._faults.pop(entry.path, None)
        self._tend()

    def _bind(self, entry: Entry) -> None:
        path = entry.path
        old = self.bound.pop(path, None)
        faults = self._faults.pop(path, None)
        if not entry.operations & _COMMANDED or entry.tenant is None:
            return
        tables = [t for t, wanted in self._tables if any(p.matches(path) for p in wanted)]
        if not tables:
            return
        envelopes = [
            MotionLimit(table, entry, self._registry, self._conditions) for table in tables
        ]
        force = old.force if old is not None and old.entry is entry else _first(entry)
        self.bound[path] = Bound(entry, envelopes, force)
        found = [f"{e.table.name}: {e.fault}" for e in envelopes if e.fault is not None]
        if found:
            self._faults[path] = found
            if found != faults:
                log.warning("envelope_does_not_fit", path=path, faults=found)

    def _tend(self) -> None:
        for bound in self.on_bound:
            bound()

    def watched(self) -> Iterator[tuple[str, Bound]]:
        """Name every sensor that says where a robot is that has to stay somewhere."""
        places = ((e.place, bound) for bound in self.bound.values() for e in bound.envelopes)
        return ((p.sensor, b) for p, b in places if p is not None and p.sensor is not None)


def _called(entry: Entry) -> bool:
    return entry.kind in (Kind.ACTION, Kind.SERVICE)


def _first(entry: Entry) -> CommandedValues:
    """Begin with what may be in force on a path of which nothing is known yet."""
    force = CommandedValues()
    if (safe := safe_value(entry)) is not None:
        force.attempt(safe)
    if entry.latest is not None and entry.operations & Operation.WRITE:
        force.attempt(entry.latest.value)
    return force
