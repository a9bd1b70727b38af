"""Visible parts of the tree per set of rights, updated in steps and only where the tree changes.

Checking twenty thousand resources against the rules takes a seventh of a second. Changes are
therefore recorded per tenant, and each set of rights processes them: a few immediately when it is
used, the rest in spare turns of the event loop.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

from rcp_kernel.access.acl import Rights
from rcp_kernel.clock import now
from rcp_kernel.model import Pattern
from rcp_scheduling.turns import Turns, Work

if TYPE_CHECKING:
    from rcp_kernel.tree.entry import Entry
    from rcp_kernel.tree.registry import Registry

__all__ = ["Hidden", "TreeView", "TreeViews"]

_STEP = 128  # paths that are judged at once: a millisecond
_NAMES = 1000  # hidden resources of a backend whose names are stored
_LONG = 1000  # changes kept of a tenant, beyond its number of resources
_ALL = Pattern("/**")


class _Change(NamedTuple):
    """A change of one path."""

    path: str
    name: str
    backend: str
    difference: int
    """How the number of paths changes: 1 if it was declared, 0 if replaced, -1 if withdrawn."""


class _Changes:
    """The changes of one tenant's part of the tree."""

    def __init__(self) -> None:
        self.base: list[_Change] = []
        """The paths before the first recorded change; never modified."""
        self.begin = 0
        """Number of the first."""
        self.kept: list[_Change] = []
        self._present: dict[str, _Change] = {}

    @property
    def end(self) -> int:
        return self.begin + len(self.kept)

    def declared(self, entry: Entry) -> None:
        made = _Change(entry.path, entry.name, entry.owner.name, 1)
        self._append(made._replace(difference=0) if entry.path in self._present else made)
        self._present[entry.path] = made

    def withdrawn(self, path: str) -> None:
        gone = self._present.get(path)
        if gone is not None:
            # First: it may start again with the current tree.
            self._append(gone._replace(difference=-1))
            del self._present[path]

    def _append(self, change: _Change) -> None:
        if len(self.kept) > len(self._present) + _LONG:
            self.begin, self.kept = self.end, []
            self.base = list(self._present.values())
        self.kept.append(change)


class Hidden:
    """The parts of one backend that are hidden from a principal."""

    __slots__ = ("count", "names")

    def __init__(self) -> None:
        self.count = 0
        self.names: set[str] = set()
        """Their names at the backend, of at most a thousand."""

    def change(self, change: _Change) -> None:
        """Count a change of a hidden path."""
        self.count += change.difference
        if change.difference < 0:
            self.names.discard(change.name)
        elif len(self.names) < _NAMES:
            self.names.add(change.name)

    def named_in(self, text: str) -> bool:
        """Return whether a text may name one of them."""
        return self.count > len(self.names) or any(name in text for name in self.names)


class _Part:
    """The visible part of one tenant's tree."""

    __slots__ = ("_base", "_first", "_place", "hidden", "visible")

    def __init__(self, changes: _Changes, *, known: bool) -> None:
        """Start with the current tree; `known`: none of it counts as a change."""
        self.visible = 0
        self.hidden: dict[str, Hidden] = {}
        """By name of the backend."""
        self._base = iter(changes.base)
        self._place = changes.begin
        self._first = changes.end if known else changes.begin
        """Number of the first unprocessed change."""

    def missed(self, changes: _Changes) -> bool:
        """Return whether unprocessed changes have been discarded."""
        return self._place < changes.begin

    def behind(self, changes: _Changes) -> bool:
        """Return whether there are unprocessed changes."""
        return self._place < changes.end

    def look(self, rights: Rights, changes: _Changes) -> Generator[None, None, bool]:
        """Process all changes in steps; return whether anything visible has changed."""
        seen = False
        for number, change in enumerate(self._base, 1):
            self._judge(rights, change)
            if not number % _STEP:
                yield
        while self.behind(changes) and not self.missed(changes):
            number = self._place
            self._place += 1
            visible = self._judge(rights, changes.kept[number - changes.begin])
            seen = seen or (visible and number >= self._first)
            if not self._place % _STEP:
                yield
        return seen

    def _judge(self, rights: Rights, change: _Change) -> bool:
        """Process a change; return whether it is visible."""
        path = change.path
        if change.difference < 0:  # not to be kept
            mask = rights.masks.get(path) or rights.compute_mask(path)
        else:
            mask = rights.mask(path)
        if mask:
            self.visible += change.difference
        else:
            self.hidden.setdefault(change.backend, Hidden()).change(change)
        return bool(mask)


class TreeView:
    """What a set of rights sees, as far as changes have been processed."""

    __slots__ = ("busy", "current", "growing", "number", "parts", "tree")

    def __init__(self, growing: set[str]) -> None:
        self.number = now() // 1_000_000  # a count would reveal changes of hidden resources
        """Incremented only when the visible part of the tree changes."""
        self.growing = growing
        """Its tenants whose backends are not all open."""
        self.parts: dict[str | None, _Part] = {}
        self.tree: int | None = None
        """Generation of the tree up to which changes have been processed."""
        self.current = False
        """Whether it was up to date when returned; unknown resources count as hidden."""
        self.busy = False
        """Whether the remaining changes are being processed."""

    @property
    def visible(self) -> int:
        """The number of visible resources."""
        return sum(part.visible for part in self.parts.values())

    def count_change(self) -> None:
        """Record that the visible part has changed."""
        self.number = max(self.number + 1, now() // 1_000_000)

    def hidden_of(self, tenant: str | None, backend: str) -> Hidden:
        """Return the hidden part of a tenant's backend."""
        part = self.parts.get(tenant)
        return (None if part is None else part.hidden.get(backend)) or Hidden()

    def mentions_hidden(self, tenant: str | None, backend: str, text: str) -> bool:
        """Return whether a text may name something hidden of a tenant's backend."""
        return not self.current or self.hidden_of(tenant, backend).named_in(text)

    def whole(self, tenant: str | None) -> bool:
        """Return whether nothing of a tenant (None: of any) is hidden."""
        meant = (
            found
            for place, part in self.parts.items()
            if place is not None and tenant in (None, place)
            for found in part.hidden.values()
        )
        return self.current and not any(found.count for found in meant)


class TreeViews:
    """The views of all sets of rights in use."""

    def __init__(self, registry: Registry, turns: Turns) -> None:
        self._registry = registry
        self._turns = turns
        self._changes: dict[str | None, _Changes] = {}
        self._known: WeakKeyDictionary[Rights, TreeView] = WeakKeyDictionary()
        registry.on_added.append(self._added)
        registry.on_removed.append(self._removed)

    def _added(self, entry: Entry) -> None:
        self._changes.setdefault(entry.tenant, _Changes()).declared(entry)

    def _removed(self, entry: Entry) -> None:
        self._changes[entry.tenant].withdrawn(entry.path)

    def growing(self, rights: Rights, pattern: Pattern = _ALL) -> set[str]:
        """Return the tenants of a principal in which a pattern may match more resources later."""
        tenants = self._registry.growing(pattern)
        return tenants if "*" in rights.tenants else tenants.intersection(rights.tenants)

    def look(self, rights: Rights) -> TreeView:
        """Return the view after one step; remaining changes are processed soon."""
        view = self._view(rights)
        if view.tree != self._registry.generation and not view.busy:
            work = self._look_further(rights, view)
            for _ in work:
                view.busy = True
                self._turns.oblige(view, self._rest(view, work))
                break
        view.current = view.tree == self._registry.generation
        return view

    def catch_up(self, rights: Rights) -> Generator[None, None, TreeView]:
        """Process all changes in steps; return the view."""
        view = self._view(rights)
        while view.tree != self._registry.generation:
            if view.busy:
                yield
            else:
                view.busy = True
                yield from self._rest(view, self._look_further(rights, view))
        view.current = True
        return view

    @staticmethod
    def _rest(view: TreeView, work: Work) -> Work:
        try:
            yield from work
        finally:
            view.busy = False

    def _view(self, rights: Rights) -> TreeView:
        known = self._known.get(rights)
        if known is None:
            known = self._known[rights] = TreeView(self.growing(rights))
            for tenant, changes in self._changes_in(rights):
                known.parts[tenant] = _Part(changes, known=True)
        return known

    def _changes_in(self, rights: Rights) -> list[tuple[str | None, _Changes]]:
        """List the parts of the tree that are visible to a principal."""
        held = (None, *rights.tenants)
        return [(t, c) for t, c in self._changes.items() if "*" in held or t in held]

    def _look_further(self, rights: Rights, view: TreeView) -> Work:
        while view.tree != (generation := self._registry.generation):
            growing = self.growing(rights)
            news = growing != view.growing
            view.growing = growing
            for tenant, changes in self._changes_in(rights):
                part = view.parts.get(tenant)
                if part is None or part.missed(changes):
                    part = view.parts[tenant] = _Part(changes, known=False)
                news |= yield from part.look(rights, changes)
                if part.missed(changes):
                    break
            else:
                view.tree = generation
            if news:
                view.count_change()
