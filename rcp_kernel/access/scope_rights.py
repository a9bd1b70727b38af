"""The rights of principals in parts of the tree, or over robots.

A part may contain twenty thousand resources, so answers are cached: a positive one with its
resource, a negative one until the tree changes. Unknown answers can be computed in steps.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from typing import TYPE_CHECKING, TypeVar
from weakref import WeakKeyDictionary

from rcp_kernel.access.acl import Rights, reach
from rcp_kernel.model import Operation
from rcp_scheduling.turns import at_once

if TYPE_CHECKING:
    from rcp_kernel.tree.entry import Entry, RobotUnit
    from rcp_kernel.tree.registry import Registry
    from rcp_kernel.tree.scope import Scope

__all__ = ["ScopeRights"]

_Key = tuple[str, int]
_Answer = TypeVar("_Answer", int, str)

_STEP = 128  # resources checked per step: a millisecond without cached rules
_KNOWN = 1000  # answers that are kept for a set of rights


class ScopeRights:
    """Checks parts of the tree by the rights of a principal."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._found: WeakKeyDictionary[Rights, dict[_Key, str]] = WeakKeyDictionary()
        """A resource for each yes."""
        self._none: WeakKeyDictionary[Rights, dict[_Key, int]] = WeakKeyDictionary()
        """The generation of the tree for each no."""

    def entries(self, scope: Scope) -> Iterator[Entry]:
        """Iterate over the resources in a scope, regardless of visibility."""
        return scope.entries(self._registry)

    def sees(self, rights: Rights, scope: Scope) -> bool:
        """Return whether a principal sees a resource in a scope."""
        return at_once(self.look(rights, scope))

    def may(self, rights: Rights, scope: Scope, operations: Operation) -> bool:
        """Return whether a principal may ever perform one of some operations in a scope.

        The current state of conditions is not considered.
        """
        return at_once(self.look(rights, scope, operations))

    def look(
        self, rights: Rights, scope: Scope, operations: Operation = Operation.NONE
    ) -> Generator[None, None, bool]:
        """Compute in steps what `may` returns, or without operations what `sees` returns."""
        return self._look(rights, scope.text, scope.entries(self._registry), int(operations))

    def sees_robot(self, rights: Rights, robot: RobotUnit, scope: Scope | None = None) -> bool:
        """Return whether a principal sees a resource of a robot, optionally within a scope."""
        own: Iterable[Entry] = robot.own.values()
        place = robot.name
        if scope is not None:
            own = (entry for entry in own if scope.covers(entry.path))
            place += scope.text
        return at_once(self._look(rights, place, own, robot=robot))

    def _look(
        self,
        rights: Rights,
        place: str,
        entries: Iterable[Entry],
        wanted: int = 0,
        robot: RobotUnit | None = None,
    ) -> Generator[None, None, bool]:
        key = place, wanted
        found = self._found.setdefault(rights, {})
        if (path := found.get(key)) is not None:
            entry = self._registry.entries.get(path)
            own = entry is not None and (robot is None or entry.unit is robot)
            if entry is not None and own and _allows(rights, entry, wanted):
                return True
            del found[key]
        none = self._none.setdefault(rights, {})
        generation = self._registry.generation
        if none.get(key) == generation:
            return False
        for number, entry in enumerate(entries, 1):
            if _allows(rights, entry, wanted):
                _keep(found, key, entry.path)
                return True
            if not number % _STEP:
                yield
        _keep(none, key, generation)
        return False


def _allows(rights: Rights, entry: Entry, wanted: int) -> bool:
    mask = rights.mask(entry.path)
    return bool(reach(mask) & int(entry.operations) & wanted) if wanted else bool(mask)


def _keep(known: dict[_Key, _Answer], key: _Key, answer: _Answer) -> None:
    if len(known) >= _KNOWN:
        known.clear()
    known[key] = answer
