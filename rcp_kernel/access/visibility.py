"""Checks whether stored information would reveal hidden resources to a reader.

A record, a command or a log line belongs to one path and may mention others: in a message, a value,
a condition, the name of a robot. It is hidden from readers that may not see one of them.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import TYPE_CHECKING, Any

import msgspec

from rcp_kernel.access.acl import Rights, reach
from rcp_kernel.access.tree_views import TreeViews
from rcp_kernel.contract.paths import (
    EVERYTHING,
    MOST_TOUCHES,
    can_name_resource,
    depth_in_tenant,
)
from rcp_kernel.model import BRANCHES, MAX_PATH, Operation, tenant_of
from rcp_kernel.values import Encoding, dump

if TYPE_CHECKING:
    from rcp_kernel.tree.entry import Entry
    from rcp_kernel.tree.registry import Registry

__all__ = ["Visibility", "names_in"]

_KINDS = tuple(map(str, BRANCHES))
_PATHS = re.compile(r"/tenant/[\w.-]+(?:/[\w.-]+)*", re.ASCII)
_SHORT = re.compile(rf"(?:{'|'.join(_KINDS)})(?:[./][\w-]+)+", re.ASCII)
_encode = msgspec.json.encode
_LONGEST = 65_536  # bytes that are searched, which takes 2 ms
_MAX_UNKNOWN = 32  # unknown names, which are checked against the rules one by one


def names_in(value: Any) -> frozenset[str]:
    """Return the possible paths and resource names in plain data, including keys.

    Data that is too long to search may name `EVERYTHING`.
    """
    try:
        text = _encode(value)
    except Exception:  # encodable only by the protocol's rules
        try:
            text = dump(value, Encoding.JSON)
        except Exception:  # data that cannot be encoded is not shown either
            return frozenset()
    if len(text) > _LONGEST:
        return frozenset((EVERYTHING,))
    plain = text.decode(errors="replace")
    found = _PATHS.findall(plain)
    rest = _PATHS.sub("", plain)
    if any(kind in rest for kind in _KINDS):  # ten times as fast as the pattern
        found += _SHORT.findall(rest)
    return frozenset(found)


class Visibility:
    """Knows the names of all resources and robots, and from whom they are hidden."""

    def __init__(self, registry: Registry, tree_views: TreeViews) -> None:
        self._registry = registry
        self._tree_views = tree_views
        self._named: dict[str, set[str]] = {}
        """The paths of resources by their names without tenant, or without tenant and robot."""
        self._robots: dict[str, set[str]] = {}
        """The paths of robots' resources by the names and keys of their robot units."""
        registry.on_added.append(self._add)
        registry.on_removed.append(self._remove)

    def _add(self, entry: Entry) -> None:
        for table, name in self._places(entry):
            table.setdefault(name, set()).add(entry.path)

    def _remove(self, entry: Entry) -> None:
        for table, name in self._places(entry):
            paths = table.get(name, set())
            paths.discard(entry.path)
            if not paths:
                table.pop(name, None)

    def _places(self, entry: Entry) -> Iterator[tuple[dict[str, set[str]], str]]:
        if entry.tenant is None:
            return
        yield self._named, entry.path.split("/", 3)[3]
        yield self._named, entry.name
        unit = entry.unit
        for name in {unit.name, unit.identity, unit.whole.name}:
            yield self._robots, name

    @property
    def generation(self) -> int:
        """Return a number that changes when something may be named that was not there before."""
        return self._registry.generation

    # -- names -----------------------------------------------------------------------------------

    def mentions_hidden(self, rights: Rights, tenant: str | None, names: Iterable[str]) -> bool:
        """Return whether one of the names refers to a hidden resource.

        A name without a tenant refers to a resource of `tenant`, or of any tenant if that is None.
        """
        unknown = 0
        for name in names:
            unknown += name not in self._registry.entries
            if unknown > _MAX_UNKNOWN or name == EVERYTHING:
                return not self.sees_whole(rights, None)
            if self._hides(rights, tenant, name[:MAX_PATH]):
                return True
        return False

    def _hides(self, rights: Rights, tenant: str | None, name: str) -> bool:
        if name.startswith("/tenant/"):
            return self.hides_path(rights, name.rstrip("."))
        segments = name.replace(".", "/").split("/")
        for end in range(2, len(segments) + 1):  # the rest of a name may be a field of the value
            for path in self._named.get("/".join(segments[:end]), ()):
                if tenant in (None, tenant_of(path)) and not rights.mask(path):
                    return True
        return False

    def hides_path(self, rights: Rights, path: str) -> bool:
        """Return whether a full path is hidden: of a resource, of none, or of a part of the tree."""
        tenant = tenant_of(path)
        if tenant is None:
            return False
        if tenant not in rights.tenants and "*" not in rights.tenants:
            return True
        if path in self._registry.entries:
            return not rights.mask(path)
        depth = depth_in_tenant(path)
        if depth == 1 and path in self._robots:
            return not self.sees_robot(rights, path, tenant)
        within = [*islice(self._below(path), MOST_TOUCHES)] if depth >= 1 else []
        if within:
            return not any(map(rights.mask, within))
        return can_name_resource(path) and not (rights.masks.get(path) or rights.compute_mask(path))

    def _below(self, path: str) -> Iterator[str]:
        index, prefix = self._registry.index, path + "/"
        for place in range(bisect_left(index, prefix), len(index)):
            if not index[place].startswith(prefix):
                return
            yield index[place]

    # -- required visibility -------------------------------------------------------------------

    def sees_all(
        self, rights: Rights, paths: Iterable[str], operation: Operation = Operation.NONE
    ) -> bool:
        """Return whether all paths are visible; those that offer `operation` must also allow it.

        The current state of conditions is not considered.
        """
        return all(self._sees(rights, path, operation) for path in paths)

    def _sees(self, rights: Rights, path: str, operation: Operation) -> bool:
        if path == EVERYTHING:
            return self.sees_whole(rights, None)
        mask = reach(rights.mask(path))
        entry = self._registry.entries.get(path)
        if not operation or entry is None or not entry.operations & operation:
            return bool(mask)
        return bool(mask & operation)

    def sees_robot(self, rights: Rights, name: str, tenant: str | None) -> bool:
        """Return whether any part of a robot is visible, by the name or key of its robot unit.

        A robot that does not exist could be any hidden one: it is visible only to those who see the
        whole tenant.
        """
        paths = self._robots.get(name)
        if paths is None:
            return self.sees_whole(rights, tenant)
        return any(map(rights.mask, paths))

    def sees_backend(self, rights: Rights, tenant: str | None, name: str) -> bool:
        """Return whether nothing of a backend is hidden."""
        if "*" not in rights.tenants and tenant not in rights.tenants:
            return False
        return not self._tree_views.look(rights).hidden_of(tenant, name).count

    def sees_whole(self, rights: Rights, tenant: str | None) -> bool:
        """Return whether nothing of a tenant is hidden; None means all tenants.

        False while changes of a large tree are being processed.
        """
        held = rights.tenants
        if "*" not in held and tenant not in held:
            return False
        return self._tree_views.look(rights).whole(tenant)
