"""The layouts that are kept, with their versions and limits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec
import structlog
from msgspec import Struct, ValidationError, convert, structs, to_builtins

from rcp_kernel.errors import PreconditionFailed, QueueFull, UnknownPath
from rcp_layouts.messages import EVERYONE, Entry, Layout
from rcp_store.plugin_store import PluginStore

__all__ = ["KeptLayouts", "Owner"]

log = structlog.get_logger("rcp.layouts")


class Owner(NamedTuple):
    """Whose a layout is: a tenant's, or that of a user by name and proof."""

    tenant: str | None = None
    user: str = ""
    proof: str = ""


class _Row(Struct, frozen=True):
    owner: Owner
    layout: Layout
    tenant: str | None = None
    """The tenant whose room it takes, also if it is a user's own; None: kept by a gateway before this one."""

    @property
    def room(self) -> str:
        """Whose limit it counts for."""
        return self.tenant or self.owner.tenant or EVERYONE


class _Removed(Struct, frozen=True):
    owner: Owner
    removed: int


class KeptLayouts:
    """All layouts by owner and name."""

    def __init__(self, store: PluginStore) -> None:
        self._store = store
        self._found: dict[tuple[Owner, str], _Row] = {}
        self._removed: dict[Owner, int] = {}
        """The highest version of a layout that an owner removed: a new one begins above it, so that
        none has the version of an earlier one of its name that somebody may still have open."""

    def restore(self) -> None:
        """Load what earlier runs have saved."""
        for key, row in self._store.load().items():
            try:
                if "removed" in row:
                    gone = convert(row, _Removed)
                    self._removed[gone.owner] = gone.removed
                    continue
                kept = convert(row, _Row)
            except ValidationError as error:
                log.warning("layout_unreadable", layout=key, error=str(error))
                continue
            self._found[kept.owner, kept.layout.name] = kept

    def listed(self, owner: Owner) -> Iterator[Entry]:
        """List an owner's layouts by name."""
        for _, name in sorted(key for key in self._found if key[0] == owner):
            yield _entry(self._found[owner, name].layout)

    def tenants(self) -> set[str]:
        """Return the tenants that share layouts."""
        return {owner.tenant for owner, _ in self._found if owner.tenant is not None}

    def get(self, owner: Owner, name: str) -> Layout:
        """Return a layout.

        :raises UnknownPath: there is none of this name.
        """
        found = self._found.get((owner, name))
        if found is None:
            raise UnknownPath(
                f"there is no layout '{name}'",
                remedy="Choose one from the list of layouts, or save one with this name.",
            )
        return found.layout

    def check(self, owner: Owner, name: str, version: int) -> None:
        """Refuse a change that was not made from the kept version.

        :raises PreconditionFailed: somebody else saved or removed it since.
        """
        found = self._found.get((owner, name))
        there = 0 if found is None else found.layout.version
        if version == there:
            return
        if found is None:
            raise PreconditionFailed(
                f"the layout '{name}' was removed since",
                details={"version": 0},
                remedy="Save it as a new layout (`version` 0).",
            )
        raise PreconditionFailed(
            f"{found.layout.by} saved the layout '{name}' since, as version {there}",
            details={"version": there, "by": found.layout.by},
            remedy="Open it again and repeat the change, or save yours under another name.",
        )

    def following(self, owner: Owner, version: int) -> int:
        """Return the version of a layout that was made from another version; 0: from none."""
        return (version or self._removed.get(owner, 0)) + 1

    def check_room(self, owner: Owner, name: str, tenant: str, of_one: int, most: int) -> None:
        """Refuse one layout too many.

        :raises QueueFull: the owner, or the tenant with all its users, has as many as it may.
        """
        if (owner, name) in self._found:
            return
        if sum(one == owner for one, _ in self._found) >= of_one:
            raise QueueFull(f"there are already {of_one} layouts here", remedy="Remove one first.")
        if sum(row.room == tenant for row in self._found.values()) >= most:
            whose = "no single tenant" if tenant == EVERYONE else f"{tenant} and its users"
            raise QueueFull(
                f"there are already {most} layouts of {whose}",
                remedy="Ask the administrator to raise `most` in [features.layouts].",
            )

    def put(self, owner: Owner, layout: Layout, tenant: str) -> Entry:
        """Keep a layout; return it as it is listed. A later version takes the room of the first."""
        earlier = self._found.get((owner, layout.name))
        row = _Row(owner, layout, tenant if earlier is None else earlier.room)
        self._found[owner, layout.name] = row
        self._store.put(_key(owner, layout.name), to_builtins(row))
        return _entry(layout)

    def remove(self, owner: Owner, name: str) -> None:
        """Remove a layout."""
        version = self._found.pop((owner, name)).layout.version
        removed = self._removed[owner] = max(self._removed.get(owner, 0), version)
        self._store.put(_key(owner), to_builtins(_Removed(owner, removed)))
        self._store.put(_key(owner, name), None)


def _entry(layout: Layout) -> Entry:
    fields: dict[str, Any] = {one.name: getattr(layout, one.name) for one in structs.fields(Entry)}
    return Entry(**fields)


def _key(owner: Owner, *name: str) -> str:
    return msgspec.json.encode([*owner, *name]).decode()
