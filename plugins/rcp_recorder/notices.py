"""What is told of robots as a whole: their states, stops, leases, the guard."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from typing import Any, NamedTuple, TypeVar
from weakref import WeakKeyDictionary

from rcp_kernel.clock import iso
from rcp_kernel.contract.events import Event
from rcp_kernel.features import FeatureHost
from rcp_kernel.tree.entry import RobotUnit
from rcp_kernel.tree.scope import Scope
from rcp_recorder.facts import robot_path
from rcp_recorder.notes import described, shortened, write
from rcp_recorder.taps import SampleCounts, Taps
from rcp_scheduling.turns import Work

__all__ = ["ROBOT_EVENTS", "Notices"]

ROBOT_EVENTS = frozenset(("guard", "lease", "stop"))
"""Events that are about robots, not about one resource."""
_OF_LEASES = ("did", "lease", "holder", "by")
_NEWEST = 4  # of one robot, or lease, that are kept until they are written
_SCOPES = 1024  # of leases of which some are kept
_STEP = 16  # leases in one step: a quarter of a millisecond
_NAME = 4  # place of a robot's name among the segments of a path
_Facts = dict[str, Any]
_Item = TypeVar("_Item")


class _Lease(NamedTuple):
    """Something that happened to a lease."""

    scope: Scope
    facts: _Facts

    def concerns(self, unit: RobotUnit, paths: Iterable[str]) -> bool:
        """Return whether it is about a robot, of which these paths are recorded."""
        scope = self.scope
        if scope.robot is not None:
            return unit.robot_segment == scope.robot
        return scope.whole or any(scope.covers(path) for path in paths)


class _Leases:
    """What happened to the leases of one tenant."""

    def __init__(self, leases: Iterable[_Lease]) -> None:
        self._of_all: list[_Lease] = []
        self._by_name: dict[str, list[_Lease]] = {}
        for lease in leases:
            name = lease.scope.robot or "".join(lease.scope.text.split("/")[_NAME : _NAME + 1])
            (self._by_name.setdefault(name, []) if name else self._of_all).append(lease)

    def near(self, unit: RobotUnit) -> Iterator[_Lease]:
        """Iterate over those that may be about a robot; one that has no name of its own has any."""
        yield from self._of_all
        if unit.robot_segment:
            yield from self._by_name.get(unit.robot_segment, ())
        else:
            yield from chain.from_iterable(self._by_name.values())


class Notices:
    """Writes notices to recordings; all of a moment at once, for robots may be many."""

    def __init__(self, host: FeatureHost, counts: SampleCounts) -> None:
        self._host = host
        self._counts = counts
        self._told: WeakKeyDictionary[Taps, dict[RobotUnit, _Facts]] = WeakKeyDictionary()
        """What was last recorded of the robots' states."""
        self._of_robots: dict[str, deque[_Facts]] = {}
        """What is to be written, by a robot's or a backend's name."""
        self._of_leases: dict[str, deque[_Lease]] = {}
        """The same, by scope."""

    def heard(self, event: Event, now: int) -> None:
        """Take in an event of robots; it is recorded with the next notices."""
        facts = described(event) | {"time": iso(now)}
        match event.what:
            case "lease":
                own = {key: event.facts[key] for key in _OF_LEASES if event.facts.get(key)}
                text = event.path or ""
                lease = _Lease(Scope(text), facts | {"scope": text} | own)
                self._of_leases[text] = self._of_leases.pop(text, deque(maxlen=_NEWEST))
                self._put(self._of_leases, text, lease)
                if len(self._of_leases) > _SCOPES:  # clients choose them, other than robots
                    oldest = self._of_leases.pop(next(iter(self._of_leases)))
                    self._counts.notices += len(oldest)
            case "stop":
                self._put(self._of_robots, str(event.facts.get("robot")), facts)
            case _:
                for name in event.facts.get("robots") or ():
                    self._put(self._of_robots, name, facts)

    def _put(self, places: dict[str, deque[_Item]], place: str, item: _Item) -> None:
        """Keep something with the newest of its place."""
        items = places.setdefault(place, deque(maxlen=_NEWEST))
        self._counts.notices += len(items) == _NEWEST
        items.append(item)

    def steps(self, places: Iterable[tuple[str, Taps]], *, states: bool = True) -> Work:
        """Record what was heard until now, and the states that have changed."""
        robots, self._of_robots = self._of_robots, {}
        heard, self._of_leases = self._of_leases, {}
        by_tenant: dict[str, list[_Lease]] = {}
        for lease in chain.from_iterable(heard.values()):
            by_tenant.setdefault(lease.scope.tenant, []).append(lease)
        leases = {tenant: _Leases(found) for tenant, found in by_tenant.items()}
        for tenant, taps in places:
            done: set[tuple[str, int]] = set()
            for unit in list(taps.units):
                yield
                if unit not in taps.units:  # it has ended
                    continue
                self._tell(taps, tenant, unit, robots, states=states)
                if tenant in leases:
                    yield from self._tell_leases(taps, tenant, unit, leases[tenant], done)
                if states:
                    self._forget(taps, unit)

    def _tell(
        self,
        taps: Taps,
        tenant: str,
        unit: RobotUnit,
        robots: Mapping[str, Iterable[_Facts]],
        *,
        states: bool,
    ) -> None:
        """Record what was heard of one robot, and its state."""
        told = self._told.setdefault(taps, {})
        names = dict.fromkeys((unit.name, unit.owner.name))
        found = [one for name in names for one in robots.get(name, ())]
        if states and told.get(unit) != (state := _state(unit)):
            told[unit] = state
            found.append(state)
        for facts in found:
            self._write(taps, tenant, facts, robot_path(unit))

    def _tell_leases(
        self,
        taps: Taps,
        tenant: str,
        unit: RobotUnit,
        leases: _Leases,
        done: set[tuple[str, int]],
    ) -> Work:
        """Record what happened to the leases of one robot; once, though it may have several parts."""
        path = robot_path(unit)
        for number, lease in enumerate(leases.near(unit), 1):
            key = path, id(lease)
            if key not in done and lease.concerns(unit, taps.units.get(unit, ())):
                done.add(key)
                self._write(taps, tenant, lease.facts, path)
            if number % _STEP == 0:
                yield

    def _forget(self, taps: Taps, unit: RobotUnit) -> None:
        """Forget a robot of which the last was told, if nothing of it is there any more."""
        if unit in taps.units and not any(taps.units[unit].values()):
            del taps.units[unit]
            self._told.get(taps, {}).pop(unit, None)

    def _write(self, taps: Taps, tenant: str, facts: _Facts, robot: str) -> None:
        now = self._host.clock.now()
        write(taps, "notice", None, tenant, now, facts | {"robot": robot})

    def incident(self, taps: Taps, tenant: str, robot: str, reason: str) -> None:
        """Record that an incident begins, and the states of all parts of its robot."""
        now = self._host.clock.now()
        facts = {"what": "incident", "robot": robot, "reason": reason}
        write(taps, "notice", None, tenant, now, facts)
        told = self._told[taps] = {unit: _state(unit) for unit in taps.units}
        for unit, state in told.items():
            write(taps, "notice", None, tenant, now, state | {"robot": robot_path(unit)})


def _state(unit: RobotUnit) -> _Facts:
    """Describe the state of a robot: whether it can be used, and what holds it."""
    facts: _Facts = {"what": "state", "state": unit.availability}
    if unit.detail:
        facts["message"] = shortened(unit.detail)
    if (latch := unit.latch) is not None:
        facts["estop"] = {
            "by": latch.by,
            "reason": shortened(latch.reason or ""),
            "since": iso(latch.since),
        }
    return facts
