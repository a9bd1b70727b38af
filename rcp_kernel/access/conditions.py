"""Conditions over the state of a robot: CEL expressions of rules, motion limits and preconditions.

A name such as `sensor.battery.percentage` refers to the robot of the requested resource. An unknown
value (never received, stale, removed, of another type) makes the result unknown unless the rest of
the expression decides.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from datetime import datetime
from typing import TYPE_CHECKING, Any, Protocol

from rcp_conditions import CLOCK, Condition, Ref, size_of
from rcp_conditions.fields import inner
from rcp_kernel.clock import Clock
from rcp_kernel.errors import RcpError
from rcp_kernel.model import full_path
from rcp_kernel.values import to_plain
from rcp_protocol.plain import is_map

if TYPE_CHECKING:
    from rcp_kernel.tree.entry import Entry
    from rcp_kernel.tree.registry import Registry

__all__ = ["Conditions", "Placed"]

RATE = 5.0
"""Hz at which the resources in conditions are watched."""

_FLOATS = {float, bool}


class Placed(Protocol):
    """An object that belongs to a robot, such as an entry."""

    @property
    def tenant(self) -> str | None:
        """Its tenant."""
        ...

    @property
    def robot(self) -> str | None:
        """The robot's name, if it has one."""
        ...


class Conditions:
    """Evaluates conditions from the registry's latest samples, and keeps those coming."""

    def __init__(
        self,
        registry: Registry,
        clock: Clock,
        *,
        sustain: Callable[[Entry, float], None],
        is_published: Callable[[Entry], bool],
    ) -> None:
        """Read values from the registry.

        `sustain` keeps an entry published at a rate in Hz; 0.0 ends it. `is_published` tells whether
        the source of an entry is kept running.
        """
        self._registry = registry
        self._now = clock.now
        self._sustain = sustain
        self._is_published = is_published
        self._used: dict[str, frozenset[str]] = {}
        self._names: Counter[str] = Counter()
        """Names of resources, each with how many parts need it."""
        self._registry.on_added.append(self._added)

    def use(self, part: str, conditions: Iterable[Condition]) -> None:
        """Keep published what a part of the configuration needs, instead of its previous needs."""
        refs = {ref for one in conditions for ref in one.refs}
        wanted = frozenset(name for ref in refs for name in _candidates(ref))
        before = self._used.pop(part, frozenset[str]())
        if wanted:
            self._used[part] = wanted
        self._names.update(wanted - before)
        self._names.subtract(before - wanted)
        # Parts change frequently: process only paths that no other part needs.
        changed = {n for n in wanted - before if self._names[n] == 1}
        for name in before - wanted:
            if not self._names[name]:
                del self._names[name]
                changed.add(name)
        if changed:
            for entry in self._registry.entries.values():
                if entry.name in changed:
                    self._added(entry)

    def _added(self, entry: Entry) -> None:
        self._sustain(entry, RATE if entry.name in self._names and not entry.live else 0.0)

    def holds(self, condition: Condition, placed: Placed) -> bool | None:
        """Return whether a condition holds for a robot; None: unknown."""
        values = self.values(condition.refs, placed)
        if condition.times:
            moment = datetime.fromtimestamp(self._now() / 1e9).astimezone()
            for ref in condition.times:
                values[ref] = CLOCK[ref[1]](moment)
        return condition.evaluate(values)

    def excess(self, condition: Condition, placed: Placed) -> str | None:
        """Return why the values are too large to evaluate a condition for a robot; None if not."""
        for ref in condition.refs:
            found = self.resource(ref, placed)
            if found is not None and self._known(found[0]) and _too_large(*found):
                return f"{'.'.join(ref)} is too large"
        return condition.excess(self.values(condition.refs, placed))

    def values(self, refs: Iterable[Ref], placed: Placed) -> dict[Ref, Any]:
        """Return the current values of names for a robot; unknown ones are left out."""
        values: dict[Ref, Any] = {}
        for ref in refs:
            found = self.resource(ref, placed)
            if found is not None and self._known(found[0]):
                self._look(values, ref, *found)
        return values

    def resource(self, ref: Ref, placed: Placed) -> tuple[Entry, Ref] | None:
        """Resolve a name for a robot: the resource, and the field within it."""
        if placed.tenant is None:
            return None
        for name in _candidates(ref):
            found = self._registry.entries.get(full_path(placed.tenant, placed.robot, name))
            if found is not None:
                return found, ref[name.count("/") + 1 :]
        return None

    def _known(self, entry: Entry) -> bool:
        return not entry.stale and (
            entry.live or entry.kind == "actuator" or self._is_published(entry)
        )

    @staticmethod
    def _look(values: dict[Ref, Any], ref: Ref, entry: Entry, field: Ref) -> None:
        assert entry.latest is not None
        try:
            raw = inner(entry.latest.value, field)
            if size_of(raw) is None:  # before it is copied
                return
            value = to_plain(raw)
        except (RcpError, LookupError, TypeError, ValueError):
            return
        if _finite(value):
            values[ref] = value


def _too_large(entry: Entry, field: Ref) -> bool:
    assert entry.latest is not None
    try:
        return size_of(inner(entry.latest.value, field)) is None
    except LookupError:
        return False


def _candidates(ref: Ref) -> list[str]:
    """List the resources that a name may mean, the longest first."""
    return ["/".join(ref[:length]) for length in range(len(ref), 1, -1)]


def _finite(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, list):
        kinds = set(map(type, value))  # pyright: ignore[reportUnknownArgumentType]
        if kinds <= _FLOATS:  # most long lists are such
            return all(map(math.isfinite, value))  # pyright: ignore[reportUnknownArgumentType]
        return all(map(_finite, value))  # pyright: ignore[reportUnknownArgumentType]
    if is_map(value):
        return all(map(_finite, value.values()))
    return True
