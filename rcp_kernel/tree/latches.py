"""Which e-stops are latched: for a robot, a tenant or the whole gateway; they survive the process.

A latch of a tenant or of the gateway holds also the robots that appear later. One robot (or
tenant) can be freed from it without the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from rcp_kernel.clock import iso, now
from rcp_store.latch_file import GATEWAY, LATCHES
from rcp_store.store import Store

__all__ = ["GATEWAY", "Latch", "Latches", "robot_key", "tenant_key"]

_TENANT = 2  # slashes in the key of a tenant; a robot's has more


class Latch:
    """A latched e-stop: who, when and why."""

    __slots__ = ("by", "freed", "reason", "shown", "since")

    def __init__(
        self, by: str, reason: str | None, since: int | None = None, freed: Iterable[str] = ()
    ) -> None:
        self.by = by
        self.reason = reason
        self.since = since or now()
        self.freed = set(freed)
        """Narrower keys that it holds no longer."""
        self.shown: Mapping[str, Any] | None = None
        """The latch as the robot's own gateway reports it, if this one only mirrors it."""

    def plain(self) -> dict[str, Any]:
        """Describe the latch."""
        if self.shown is not None:
            return dict(self.shown)
        return {"by": self.by, "reason": self.reason, "since": iso(self.since)}


def tenant_key(tenant: str) -> str:
    """Return the key of a tenant's latch."""
    return f"/tenant/{tenant}"


def robot_key(tenant: str, place: str) -> str:
    """Return the key that all backends of a robot share; `place` is empty if the tenant has only one robot."""
    return f"/tenant/{tenant}/{place}"


class Latches:
    """Every latched e-stop, by key."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self.on_change: list[Callable[[], None]] = []
        """Called after every change."""
        self.by_key = {key: _read(kept) for key, kept in store.load(LATCHES, unreadable={}).items()}
        """Changed in place: each robot refers to it."""

    def of(self, keys: tuple[str, ...]) -> Latch | None:
        """Return what holds a robot: its keys below the gateway's, the narrowest first.

        A latch of its own gateway only if there is no other.
        """
        held, shown = self.by_key, None
        for key in (*keys, GATEWAY):
            latch = held.get(key)
            if latch is not None and latch.freed.isdisjoint(keys):
                if latch.shown is None:
                    return latch
                shown = latch
        return shown

    @property
    def wide(self) -> dict[str, Latch]:
        """The latches of tenants and of the gateway, by key."""
        return {key: latch for key, latch in self.by_key.items() if _wide(key)}

    def set(self, key: str, by: str, reason: str | None) -> None:
        """Latch; an older latch of the same key is kept and applies to all again."""
        latch = self.by_key.get(key)
        if latch is None or latch.shown is not None:
            latch = self.by_key[key] = Latch(by, reason)
        latch.freed.clear()
        self._keep(key, latch)

    def show(self, key: str, facts: Mapping[str, Any] | None) -> None:
        """Show the latch of a robot's own gateway, or no longer; it is not stored."""
        latch = self.by_key.get(key)
        if latch is not None and latch.shown is None:
            return  # a latch of this gateway
        if facts is None:
            if latch is None:
                return
            del self.by_key[key]
        else:
            latch = self.by_key[key] = Latch(str(facts.get("by")), facts.get("reason"))
            latch.shown = facts
        self._tell_changed()

    def reset(self, key: str, wider: Iterable[str]) -> None:
        """Release a key's robots, even from wider latches, except the gateway's."""
        for narrower in self._within(key):
            del self.by_key[narrower]
            self._keep(narrower, None)
        for other in {*wider, GATEWAY} - {key}:
            latch = self.by_key.get(other)
            if latch is not None:
                latch.freed.add(key)
                self._keep(other, latch)

    def _within(self, key: str) -> list[str]:
        if key == GATEWAY:  # what a robot's own gateway holds is reset there
            return [held for held, latch in self.by_key.items() if latch.shown is None]
        below = key + "/"  # the robots of a backend, or of a tenant
        return [held for held in self.by_key if held == key or held.startswith(below)]

    def _keep(self, key: str, latch: Latch | None) -> None:
        kept: dict[str, Any] | None = None
        if latch is not None:
            freed = sorted(latch.freed)
            kept = {"by": latch.by, "reason": latch.reason, "since": latch.since, "freed": freed}
        self._store.put(LATCHES, key, kept)
        self._tell_changed()

    def _tell_changed(self) -> None:
        for changed in self.on_change:
            changed()


def _read(kept: Any) -> Latch:
    try:
        return Latch(kept["by"], kept["reason"], int(kept["since"]), kept["freed"])
    except (KeyError, TypeError, ValueError):  # it was latched, which is all that matters
        return Latch("the gateway", "the stored state of this e-stop cannot be read")


def _wide(key: str) -> bool:
    return key == GATEWAY or (key.startswith("/") and key.count("/") == _TENANT)
