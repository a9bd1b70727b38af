"""Who has control of a robot: the holder of a lease, or whoever commands it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from rcp_inventory.messages import Control
from rcp_kernel.clock import iso
from rcp_kernel.features import Call, CommandObserver, FeatureHost
from rcp_kernel.features.control import HOLDERS
from rcp_kernel.safety.safe_value import is_safe
from rcp_kernel.tree.entry import Entry

__all__ = ["Controllers"]

Commanding = dict[str, str]
"""Principals by the paths of their running commands."""
_MOST = 16  # unconfirmed writes of a path; older ones are dropped


class _Write(NamedTuple):
    """A value that may be in force, and who wrote it."""

    value: Any
    principal: str


class Controllers(CommandObserver):
    """Notes who commands what."""

    writes_only = True

    def __init__(self, host: FeatureHost, *, changed: Callable[[], None]) -> None:
        """Know of no command; `changed` is called when somebody else has control."""
        self._host = host
        self._changed = changed
        self._writes: dict[str, list[_Write]] = {}
        """The values that may be in force, by path, the newest last; never an empty list."""

    def running(self) -> Commanding:
        """Return who has commands running."""
        return {c.path: c.principal for c in self._host.control.running()}

    def of(self, entries: Iterable[Entry], running: Commanding) -> Control | None:
        """Return who has control of something among the resources of a robot that move."""
        commanded: Control | None = None
        leases = self._host.service(HOLDERS)
        for entry in entries:
            if leases is not None and (held := leases.holder(entry)) is not None:
                expires = iso(held.expires)
                return Control(held.principal, "lease", scope=held.scope.text, expires=expires)
            if commanded is not None:
                continue
            if (principal := running.get(entry.path)) is not None:
                commanded = Control(principal, "command", path=entry.path)
            elif (writes := self._writes.get(entry.path)) is not None:
                commanded = Control(writes[-1].principal, "write", path=entry.path)
        return commanded

    def forget(self, path: str) -> None:
        """Note that nothing that was written to a path is in force any more."""
        if self._writes.pop(path, None) is not None:
            self._changed()

    # -- CommandObserver -------------------------------------------------------------------------

    def sent(self, call: Call) -> None:
        """Note who writes to something that has a safe value: until that is in force again."""
        entry, principal = call.entry, call.session.principal.name
        if entry.resource.safe is None or call.rests:
            return
        writes = self._writes.setdefault(entry.path, [])
        news = not writes or writes[-1].principal != principal
        writes.append(_Write(call.value, principal))
        del writes[:-_MOST]
        if news:
            self._changed()

    def took(self, entry: Entry, value: Any, actual: Any) -> None:
        """Forget who wrote before; also who wrote this, if it brought the robot to rest."""
        writes = self._writes.get(entry.path)
        if writes is None:
            return
        if is_safe(entry, value):
            self.forget(entry.path)
        elif (place := _place(writes, value)) is not None:
            del writes[:place]

    def refused(self, entry: Entry, value: Any) -> None:
        """Forget who wrote it: what was in force before still is."""
        writes = self._writes.get(entry.path)
        if writes is None or (place := _place(writes, value)) is None:
            return
        if len(writes) == 1:
            self.forget(entry.path)
        else:
            del writes[place]
            self._changed()

    def rested(self, entry: Entry, safe: Any) -> None:
        """Forget who wrote."""
        self.forget(entry.path)


def _place(writes: list[_Write], value: Any) -> int | None:
    """Find the latest write of a value."""
    places = range(len(writes) - 1, -1, -1)
    return next((place for place in places if writes[place].value is value), None)
