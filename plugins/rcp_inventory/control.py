"""Who has control of a robot: the holder of a lease, or whoever commands it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from rcp_inventory.messages import Control
from rcp_kernel.clock import iso
from rcp_kernel.features import Call, FeatureHost
from rcp_kernel.features.control import HOLDERS
from rcp_kernel.safety.safety import is_safe
from rcp_kernel.tree.entry import Entry

__all__ = ["Controllers"]

Commanding = dict[str, str]
"""Principals by the paths of their running commands."""


class Controllers:
    """Notes who commands what, as the feature's `CommandObserver`."""

    def __init__(self, host: FeatureHost, *, changed: Callable[[], None]) -> None:
        """Know of no command; `changed` is called when somebody else has control."""
        self._host = host
        self._changed = changed
        self._writers: dict[str, str] = {}
        """Who wrote the value in force, by path."""

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
            elif (principal := self._writers.get(entry.path)) is not None:
                commanded = Control(principal, "write", path=entry.path)
        return commanded

    def forget(self, path: str) -> None:
        """Note that nothing that was written to a path is in force any more."""
        if self._writers.pop(path, None) is not None:
            self._changed()

    # -- CommandObserver -------------------------------------------------------------------------

    def sent(self, call: Call) -> None:
        """Note who writes to something that has a safe value: until that is in force again."""
        entry, principal = call.entry, call.session.principal.name
        if call.request.type != "write" or entry.resource.safe is None:
            return
        if self._writers.get(entry.path) != principal and not call.rests:
            self._writers[entry.path] = principal
            self._changed()

    def took(self, entry: Entry, value: Any, actual: Any) -> None:
        """Forget who wrote before, if the client itself brought it to rest."""
        if entry.path in self._writers and is_safe(entry, value):
            self.forget(entry.path)

    def refused(self, entry: Entry, value: Any) -> None:
        """Do nothing: what was in force before still is."""

    def stopping(self, entry: Entry, safe: Any) -> None:
        """Do nothing: it still moves."""

    def rested(self, entry: Entry, safe: Any) -> None:
        """Forget who wrote."""
        self.forget(entry.path)
