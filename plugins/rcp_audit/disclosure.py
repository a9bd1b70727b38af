"""Who may see which records: readers of the tenants' audit who may see everything named in them."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from rcp_audit.records import PATH
from rcp_kernel.access.acl import Rights
from rcp_kernel.access.visibility import Visibility, names_in
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.latches import GATEWAY
from rcp_protocol.plain import is_list, is_map

__all__ = ["Disclosure"]

_LOOK = Operation.READ | Operation.SUBSCRIBE
_KNOWN = 2000  # records with cached names
_KEPT = 20_000  # cached verdicts: enough for twenty sets of rights and the whole history
_PLANS = "/system/plans"  # in records of older gateways
_PLAN = frozenset(("name", "steps", "symbolic", "lines"))  # possible fields of a plan
_ROBOTS = ("robots", "latches")
_WHOLE = 2  # slashes of the key of a tenant


class _Verdict(NamedTuple):
    record: dict[str, Any]
    visible: dict[str, Any] | None


class Disclosure:
    """Filters records by the rights of their reader."""

    def __init__(self, visibility: Visibility) -> None:
        self._visibility = visibility
        self._reach: WeakKeyDictionary[Rights, tuple[str, ...]] = WeakKeyDictionary()
        self._names: OrderedDict[Any, frozenset[str]] = OrderedDict()
        self._verdicts = _Verdicts()

    def shown(self, session: Session, record: dict[str, Any]) -> dict[str, Any] | None:
        """Return the part of a record that a session may see; None if it may not see any."""
        rights, generation = session.rights, self._visibility.generation
        if not self.concerns(rights, record):
            return None
        try:
            return self._verdicts.find(rights, generation, record)
        except KeyError:
            visible = self._masked(rights, record) if self._sees(rights, record) else None
            self._verdicts.keep(rights, generation, record, visible)
            return visible

    def concerns(self, rights: Rights, record: dict[str, Any]) -> bool:
        """Return whether the rights cover the audit of every tenant of a record."""
        reach = self._reach_of(rights)
        if "*" in reach:
            return True
        tenants: Any = record.get("tenants") or (record.get("tenant"),)
        return all(tenant in reach for tenant in tenants)

    def _sees(self, rights: Rights, record: dict[str, Any]) -> bool:
        visibility, tenant = self._visibility, record.get("tenant")
        if _has_whole_plan(record):
            return visibility.sees_whole(rights, None)
        # Seeing a path is enough for its commands; values that were read also need READ.
        needed = Operation.READ if record.get("what") == "read" else Operation.NONE
        if not visibility.sees_all(rights, record.get("touches", ()), needed):
            return False
        robot = record.get("robot")
        if robot is not None and not visibility.sees_robot(rights, robot, tenant):
            return False
        return not visibility.mentions_hidden(rights, tenant, self._names_of(record))

    def _masked(self, rights: Rights, record: dict[str, Any]) -> dict[str, Any] | None:
        """Remove hidden robots; None if no others are left."""
        robots = {key: record[key] for key in _ROBOTS if is_list(record.get(key))}
        if not any(robots.values()):
            return record
        tenant = record.get("tenant")
        kept = {
            key: [name for name in names if self._sees_latch(rights, tenant, str(name))]
            for key, names in robots.items()
        }
        if kept == robots:
            return record
        return {**record, **kept} if any(kept.values()) else None

    def _sees_latch(self, rights: Rights, tenant: str | None, key: str) -> bool:
        """Return whether the latch of a robot, a tenant or the gateway is visible."""
        if key == GATEWAY:
            return True
        if key.startswith("/") and key.count("/") == _WHOLE:
            return not self._visibility.hides_path(rights, key)
        return self._visibility.sees_robot(rights, key, tenant)

    def _names_of(self, record: dict[str, Any]) -> frozenset[str]:
        """Return the names in a record, without unknown paths and the keys of stops."""
        seq: Any = record.get("seq")
        known = self._names.get(seq)
        if known is None:
            known = self._names[seq] = names_in(_named_fields(record))
            if len(self._names) > _KNOWN:
                self._names.popitem(last=False)
        return known

    def _reach_of(self, rights: Rights) -> tuple[str, ...]:
        reach = self._reach.get(rights)
        if reach is None:
            reach = self._reach[rights] = rights.places(PATH, _LOOK)
        return reach


class _Verdicts:
    """Cached results per set of rights, valid until the tree changes.

    Every read and every subscriber goes through the same records.
    """

    def __init__(self) -> None:
        self._kept: WeakKeyDictionary[Rights, dict[int, _Verdict]] = WeakKeyDictionary()
        self._generation = 0
        self._count = 0

    def find(
        self, rights: Rights, generation: int, record: dict[str, Any]
    ) -> dict[str, Any] | None:
        """Return the visible part of a record.

        :raises KeyError: it is not cached.
        """
        if generation != self._generation:
            raise KeyError(generation)
        verdict = self._kept[rights][id(record)]
        if verdict.record is not record:
            raise KeyError(id(record))
        return verdict.visible

    def keep(
        self,
        rights: Rights,
        generation: int,
        record: dict[str, Any],
        visible: dict[str, Any] | None,
    ) -> None:
        """Cache the visible part of a record; a full cache is cleared first."""
        if generation != self._generation or self._count >= _KEPT:
            self._kept.clear()
            self._generation, self._count = generation, 0
        self._count += 1
        self._kept.setdefault(rights, {})[id(record)] = _Verdict(record, visible)


def _named_fields(record: dict[str, Any]) -> dict[str, Any]:
    """Drop fields that are checked separately, or that name paths which do not exist."""
    left_out = {"touches", *_ROBOTS}
    if {record.get("outcome"), *record.get("codes", ())} <= {"unknown_path", None}:
        left_out |= {"path", "paths", "message"}
    return {key: value for key, value in record.items() if key not in left_out}


def _has_whole_plan(record: dict[str, Any]) -> bool:
    """Return whether a record contains a plan with its values, as older gateways wrote them."""
    if "touches" in record:
        return False
    if record.get("path") == _PLANS and record.get("what") in ("execute", "command", "approval"):
        return True
    value = record.get("value")
    return (
        record.get("what") == "denial" and is_map(value) and bool(value) and value.keys() <= _PLAN
    )
