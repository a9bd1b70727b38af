"""The registry: every path with its resource, types, latest sample and backend.

Lookups are one dictionary access. Searches (patterns, discovery) use a sorted index that is rebuilt
when the tree changes, never for a request.
"""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator

from rcp_kernel.clock import Clock
from rcp_kernel.contract.paths import names_of
from rcp_kernel.errors import PluginError, RcpError
from rcp_kernel.model import Kind, Pattern, Resource, full_path, kind_of
from rcp_kernel.tree.entry import Entry, Owner, RobotUnit
from rcp_kernel.values import value_type

__all__ = ["Registry"]

_WITHDRAWN = 10_000  # withdrawn paths whose sequence number is remembered


class Registry:
    """The tree. Only the event loop's thread touches it."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.entries: dict[str, Entry] = {}
        self.generation = 0
        """Rises with every change of the tree: the validator of caches and ETags."""
        self.on_added: list[Callable[[Entry], None]] = []
        self.on_removed: list[Callable[[Entry], None]] = []
        self.on_state: list[Callable[[], None]] = []
        """Called when the state of some robot, or what is known about it, may have changed."""
        self.on_leases: list[Callable[[RobotUnit], None]] = []
        """Called when a robot's own gateway has said who holds leases on it."""
        self._growing: list[Owner] = []
        """Backends that have not declared all that they may have."""
        self._index: list[str] | None = None
        self._numbers: dict[str, int] = {}
        """Last sample number of withdrawn paths, so that a path that returns counts on."""

    def declare(
        self, owner: Owner, resource: Resource, *, tenant: str, robot: str | None = None
    ) -> Entry:
        """Put a backend's resource into the tree, or replace it.

        :raises PluginError: the path belongs to another backend, a type has no schema, or an
            example does not fit its type.
        """
        path = full_path(tenant, robot, resource.name)
        return self.insert(Entry(path, _checked(resource), owner, tenant, robot, self.clock))

    def insert(self, entry: Entry) -> Entry:
        """Put an entry into the tree.

        :raises PluginError: its path belongs to another backend.
        """
        old = self.entries.get(entry.path)
        if old is not None:
            if old.owner is not entry.owner:
                raise PluginError(
                    f"{entry.path} is declared by backend '{old.owner.name}' and by "
                    f"'{entry.owner.name}': set a different `robot` for one of them"
                )
            if old.resource == entry.resource:
                return old
            entry.adopt(old)
        else:
            entry.seq = self._numbers.pop(entry.path, 0)
        self.entries[entry.path] = entry
        self._changed()
        for callback in self.on_added:
            callback(entry)
        return entry

    def withdraw(self, path: str) -> None:
        """Remove an entry from the tree; an unknown path is ignored."""
        entry = self.entries.pop(path, None)
        if entry is None:
            return
        self._numbers[path] = entry.seq
        while len(self._numbers) > _WITHDRAWN:
            del self._numbers[next(iter(self._numbers))]
        self._changed()
        for callback in self.on_removed:
            callback(entry)

    def state_changed(self) -> None:
        """Announce that the state of some robot, or what is known about it, may have changed."""
        for callback in self.on_state:
            callback()

    def leases_changed(self, unit: RobotUnit) -> None:
        """Announce that a robot's own gateway has reported the leases on it."""
        for callback in self.on_leases:
            callback(unit)

    def set_incomplete(self, owner: Owner, *, incomplete: bool) -> None:
        """Record whether a backend may declare more resources: it is opening, or discovering."""
        if incomplete == (owner in self._growing):
            return
        if incomplete:
            self._growing.append(owner)
        else:
            self._growing.remove(owner)
        self.generation += 1

    def may_come(self, path: str) -> bool:
        """Return whether a path that is not in the tree may still be declared."""
        return bool(self._growing) and any(_may_own(owner, path) for owner in self._growing)

    def growing(self, pattern: Pattern) -> set[str]:
        """Return the tenants in which a pattern may reach more when all backends are open."""
        if pattern.literal:
            owners = [o for o in self._growing if _may_own(o, pattern.text)]
        else:
            owners = [o for o in self._growing if _meet(pattern.prefix, f"/tenant/{o.tenant}")]
        return {owner.tenant for owner in owners if owner.tenant is not None}

    def _changed(self) -> None:
        self.generation += 1
        self._index = None

    @property
    def index(self) -> list[str]:
        """Every path, sorted."""
        if self._index is None:
            self._index = sorted(self.entries)
        return self._index

    def match(self, pattern: Pattern, after: str = "") -> Iterator[Entry]:
        """Iterate over the matches of a pattern, in order of path, after `after`."""
        if pattern.literal:
            entry = self.entries.get(pattern.text)
            if entry is not None and entry.path > after:
                yield entry
            return
        index = self.index
        start = max(bisect_left(index, pattern.prefix), bisect_right(index, after))
        for path in index[start:]:
            if not path.startswith(pattern.prefix):
                break
            # Entries may disappear while a caller iterates in steps.
            if pattern.matches(path) and (entry := self.entries.get(path)) is not None:
                yield entry


def _may_own(owner: Owner, path: str) -> bool:
    names = names_of(path, owner.tenant)
    if owner.robot is None:
        return bool(names)
    return len(names) > 1 and names[0] == owner.robot


def _meet(prefix: str, place: str) -> bool:
    """Return whether one of two paths contains the other."""
    return f"{prefix}/".startswith(f"{place}/") or f"{place}/".startswith(f"{prefix}/")


_SENTENCE = re.compile(r"\S.*\.\Z", re.DOTALL)


def _checked(resource: Resource) -> Resource:
    kind = kind_of(resource.name)
    called = kind in (Kind.ACTION, Kind.SERVICE)
    if not called and resource.value is None:
        raise PluginError(f"resource '{resource.name}' declares no type for its `value`")
    if not _SENTENCE.match(resource.description):
        raise PluginError(
            f"the description of '{resource.name}' must be a sentence that ends in a full stop"
        )
    type_ = value_type(resource.input if called else resource.value)
    for example in resource.examples:
        try:
            type_.convert(example, f"example of '{resource.name}'")
        except RcpError as error:
            raise PluginError(error.message) from None
    if resource.valid_for is not None and resource.safe is None:
        raise PluginError(f"'{resource.name}' has `valid_for` and no `safe` value to fall back to")
    return resource
