"""Who is told what of the record: those whose audit it concerns, and who may see all it names."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from rcp_audit.log import PATH
from rcp_kernel._plain import is_list, is_map
from rcp_kernel.access.acl import Rights
from rcp_kernel.access.visibility import Visibility, names_in
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.latches import GATEWAY

__all__ = ["Disclosure"]

_LOOK = Operation.READ | Operation.SUBSCRIBE
_KNOWN = 2000  # records whose names are remembered
_KEPT = 20_000  # verdicts: of twenty sets of rights about all records at hand
_PLANS = "/system/plans"  # in records of gateways before this one
_PLAN = frozenset(("name", "steps", "symbolic", "lines"))  # what the body of a plan may have
_ROBOTS = ("robots", "latches")
_WHOLE = 2  # slashes of the key of a tenant


class _Verdict(NamedTuple):
    record: dict[str, Any]
    told: dict[str, Any] | None


class Disclosure:
    """Shows each reader the records, and the parts of records, that he may see."""

    def __init__(self, visibility: Visibility) -> None:
        self._visibility = visibility
        self._reach: WeakKeyDictionary[Rights, tuple[str, ...]] = WeakKeyDictionary()
        self._names: OrderedDict[Any, frozenset[str]] = OrderedDict()
        self._verdicts = _Verdicts()

    def shown(self, session: Session, record: dict[str, Any]) -> dict[str, Any] | None:
        """Return a record as a session may see it; None if it may not at all."""
        rights, generation = session.rights, self._visibility.generation
        if not self.concerns(rights, record):
            return None
        try:
            return self._verdicts.find(rights, generation, record)
        except KeyError:
            told = self._masked(rights, record) if self._sees(rights, record) else None
            self._verdicts.keep(rights, generation, record, told)
            return told

    def concerns(self, rights: Rights, record: dict[str, Any]) -> bool:
        """Tell whether somebody may see the audit of all tenants that a record is of."""
        reach = self._reach_of(rights)
        if "*" in reach:
            return True
        tenants: Any = record.get("tenants") or (record.get("tenant"),)
        return all(tenant in reach for tenant in tenants)

    def _sees(self, rights: Rights, record: dict[str, Any]) -> bool:
        sight, tenant = self._visibility, record.get("tenant")
        if _tells_of_a_whole_plan(record):
            return sight.sees_whole(rights, None)
        # A command shows to whoever sees its path, the value that was read to who may read it too.
        wanted = Operation.READ if record.get("what") == "read" else Operation.NONE
        if not sight.sees_all(rights, record.get("touches", ()), wanted):
            return False
        robot = record.get("robot")
        if robot is not None and not sight.sees_robot(rights, robot, tenant):
            return False
        return not sight.names_hidden(rights, tenant, self._names_of(record))

    def _masked(self, rights: Rights, record: dict[str, Any]) -> dict[str, Any] | None:
        """Leave out the robots that are hidden; None if there are no others."""
        told = {key: record[key] for key in _ROBOTS if is_list(record.get(key))}
        if not any(told.values()):
            return record
        tenant = record.get("tenant")
        kept = {
            key: [name for name in names if self._sees_latch(rights, tenant, str(name))]
            for key, names in told.items()
        }
        if kept == told:
            return record
        return {**record, **kept} if any(kept.values()) else None

    def _sees_latch(self, rights: Rights, tenant: str | None, key: str) -> bool:
        """Tell whether the latch of a robot, a tenant or the gateway may be told of."""
        if key == GATEWAY:
            return True
        if key.startswith("/") and key.count("/") == _WHOLE:
            return not self._visibility.hides_path(rights, key)
        return self._visibility.sees_robot(rights, key, tenant)

    def _names_of(self, record: dict[str, Any]) -> frozenset[str]:
        """Return what a record names, beside what was asked for in vain and the keys of stops."""
        seq: Any = record.get("seq")
        known = self._names.get(seq)
        if known is None:
            known = self._names[seq] = names_in(_telling(record))
            if len(self._names) > _KNOWN:
                self._names.popitem(last=False)
        return known

    def _reach_of(self, rights: Rights) -> tuple[str, ...]:
        reach = self._reach.get(rights)
        if reach is None:
            reach = self._reach[rights] = rights.places(PATH, _LOOK)
        return reach


class _Verdicts:
    """What was found to be shown of records: to each set of rights, as long as the tree stays.

    The same records are looked through again and again: by each read, and for each subscriber.
    """

    def __init__(self) -> None:
        self._kept: WeakKeyDictionary[Rights, dict[int, _Verdict]] = WeakKeyDictionary()
        self._generation = 0
        self._count = 0

    def find(
        self, rights: Rights, generation: int, record: dict[str, Any]
    ) -> dict[str, Any] | None:
        """Return what is shown of a record.

        :raises KeyError: it is not known.
        """
        if generation != self._generation:
            raise KeyError(generation)
        verdict = self._kept[rights][id(record)]
        if verdict.record is not record:
            raise KeyError(id(record))
        return verdict.told

    def keep(
        self, rights: Rights, generation: int, record: dict[str, Any], told: dict[str, Any] | None
    ) -> None:
        """Keep what is shown of a record; too many, and all are forgotten."""
        if generation != self._generation or self._count >= _KEPT:
            self._kept.clear()
            self._generation, self._count = generation, 0
        self._count += 1
        self._kept.setdefault(rights, {})[id(record)] = _Verdict(record, told)


def _telling(record: dict[str, Any]) -> dict[str, Any]:
    """Leave out what is looked at by itself, or tells what was asked for and not what there is."""
    left_out = {"touches", *_ROBOTS}
    if {record.get("outcome"), *record.get("codes", ())} <= {"unknown_path", None}:
        left_out |= {"path", "paths", "message"}
    return {key: value for key, value in record.items() if key not in left_out}


def _tells_of_a_whole_plan(record: dict[str, Any]) -> bool:
    """Tell whether a record has a plan with its values: as gateways before this one wrote them."""
    if "touches" in record:
        return False
    if record.get("path") == _PLANS and record.get("what") in ("execute", "command", "approval"):
        return True
    value = record.get("value")
    return (
        record.get("what") == "denial" and is_map(value) and bool(value) and value.keys() <= _PLAN
    )
