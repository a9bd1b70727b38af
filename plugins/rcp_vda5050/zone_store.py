"""The zone sets of one robot in the gateway's store, with the one that is in force.

A row for each set, and one that names the enabled one, all of the robot's present map.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec
import structlog

from rcp_gateway.api import PluginStore
from rcp_protocol.timeouts import timeout
from rcp_vda5050.config import RobotConfig
from rcp_vda5050.zone_messages import ZoneSet
from rcp_vda5050.zone_sets import UNKNOWN

__all__ = ["Kept", "ZoneStore", "load_rows"]

log = structlog.get_logger("rcp.vda5050")
_STORED = 1.0  # s to wait for the store; a broken one must not keep the robot from its orders
_UNREADABLE: dict[str, Any] = {}


class Kept(NamedTuple):
    """What earlier runs have kept of one robot."""

    sets: list[ZoneSet]
    enabled: str | None
    """The set that was in force, which may be one that is lost."""
    lost: dict[str, str]
    """Sets that cannot be read, with the reason."""
    was_lost: bool = False
    """Whether the set that was in force has been lost since: only who enables it puts it in force again."""


def load_rows(store: PluginStore) -> Mapping[str, Any]:
    """Return the rows of all robots; blocks."""
    return store.load(unreadable=_UNREADABLE)


class ZoneStore:
    """The rows of one robot; `changed` is called when `late` has changed."""

    def __init__(
        self, store: PluginStore, config: RobotConfig, changed: Callable[[], None]
    ) -> None:
        self._store, self._changed = store, changed
        self._key = [config.manufacturer, config.serial, config.map]
        self._count = 0
        self._written = asyncio.Event()
        self._written.set()
        self.late = False
        """Whether something is not stored yet, and has been waited for."""

    def restore(self, rows: Mapping[str, Any]) -> Kept:
        """Return what is there of this robot. A row that is damaged is kept, and told."""
        kept = Kept([], None, {})
        for key, row in rows.items():
            named = _named(key)
            if named[:3] != self._key:
                continue
            if len(named) == 3:
                enabled, was_lost = _in_force(row)
                kept = kept._replace(enabled=enabled, was_lost=was_lost)
                continue
            try:
                kept.sets.append(_read(row, named[3]))
            except (msgspec.MsgspecError, ValueError) as error:
                log.warning("zone_set_unreadable", robot=self._key[1], zone_set=named[3], error=str(error))  # fmt: skip
                kept.lost[named[3]] = "its row in the store is damaged"
        there = {UNKNOWN, *(each.zone_set_id for each in kept.sets)}
        if kept.enabled is not None and kept.enabled not in there:
            kept.lost.setdefault(kept.enabled, "its row in the store is missing")
        return kept

    def put(self, given: ZoneSet) -> None:
        """Store a set."""
        data = msgspec.json.encode(given)
        self._put([*self._key, given.zone_set_id], {"set": data, "sha256": _digest(data)})

    def enable(self, id_: str) -> None:
        """Store which set is in force."""
        self._put(self._key, {"enabled": id_})

    def mark_lost(self, id_: str) -> None:
        """Store that a set was in force and lost, before it is stored again."""
        self._put(self._key, {"enabled": id_, "lost": True})

    def delete(self, id_: str) -> None:
        """Remove a set."""
        self._put([*self._key, id_], None)

    def disable(self) -> None:
        """Store that none is in force."""
        self._put(self._key, None)

    def _put(self, key: list[str], value: Any) -> None:
        self._count += 1
        count = self._count
        self._written.clear()
        self._store.put(msgspec.json.encode(key).decode(), value)
        self._store.settled(lambda: self._settled(count))

    def _settled(self, count: int) -> None:
        if count == self._count:
            self._written.set()
            self._say(late=False)

    async def confirm(self) -> None:
        """Wait until everything is stored; if that takes long, go on and note that it is late."""
        try:
            async with timeout(_STORED):
                await self._written.wait()
        except TimeoutError:
            self._say(late=True)

    def _say(self, *, late: bool) -> None:
        if late != self.late:
            self.late = late
            self._changed()


def _named(key: str) -> list[str]:
    try:
        return msgspec.json.decode(key, type=list[str])
    except msgspec.MsgspecError:
        return []


def _in_force(row: Any) -> tuple[str, bool]:
    """Return the set that a row names, and whether it has been lost since."""
    enabled = row.get("enabled") if isinstance(row, dict) else None
    return (enabled, "lost" in row) if isinstance(enabled, str) else (UNKNOWN, True)


def _read(row: Any, id_: str) -> ZoneSet:
    """Return the set of a row.

    :raises ValueError: it is damaged.
    """
    data = row.get("set") if isinstance(row, dict) else None
    if not isinstance(data, bytes) or row.get("sha256") != _digest(data):
        raise ValueError("it is not what was stored")
    found = msgspec.json.decode(data, type=ZoneSet)
    if found.zone_set_id != id_:
        raise ValueError(f"it is the set {found.zone_set_id}")
    return found


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()
