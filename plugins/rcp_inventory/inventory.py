"""The list of robots, made for each reader from what it may see."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Literal

import msgspec

from rcp_inventory.control import Commanding, Controllers
from rcp_inventory.fleet import Fleet, Member, Robot
from rcp_inventory.messages import FactSheet, Reading, RobotState
from rcp_inventory.words import matches, search_text, words_of
from rcp_kernel.access.acl import Rights
from rcp_kernel.errors import RcpError
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_kernel.spi import RobotFacts
from rcp_kernel.tree.entry import Availability, RobotUnit
from rcp_kernel.values import to_plain

__all__ = ["Inventory"]

_STEP = 64  # resources that are looked at in one step
_MODE, _POSE, _BATTERY = "sensor/mode", "sensor/pose", "sensor/battery"
_MARK = {_POSE: "position", _BATTERY: "percentage"}
"""A field that tells a value of this meaning from another one of the same name."""


class Inventory:
    """Lists the robots."""

    def __init__(self, fleet: Fleet, controllers: Controllers) -> None:
        self._fleet = fleet
        self._controllers = controllers

    def view(self, session: Session) -> Iterator[dict[str, Any] | None]:
        """List the robots of which a session sees something, in steps."""
        return self.pages(session, q="", after="")

    def pages(self, session: Session, /, *, q: str, after: str) -> Iterator[dict[str, Any] | None]:
        """List those that match the words `q`, after a path."""
        rights, words = session.rights, words_of(q)
        running = self._controllers.running()
        for robot in self._fleet.after(after):
            seen: list[Member] = []
            for number, member in enumerate(list(robot.members.values()), 1):
                if rights.mask(member.entry.path):
                    seen.append(member)
                if not number % _STEP:
                    yield None
            units = dict.fromkeys(member.entry.unit for member in seen)
            if not any(map(_is_robot, units)):
                yield None
                continue
            view = _View(robot, seen, list(units))
            if words and not matches(view.text, words):
                yield None
                continue
            yield from view.in_steps(rights, self._controllers, running)


class _View:
    """One robot as one reader sees it."""

    def __init__(self, robot: Robot, members: list[Member], units: list[RobotUnit]) -> None:
        self._robot = robot
        self._members = members
        self._units = units
        self._facts = _facts_of(units)
        names = (name for member in members for name in member.entry.resource.profiles)
        self._profiles = tuple(sorted(set(names)))

    @property
    def text(self) -> str:
        """The text in which a search looks."""
        facts = self._facts
        terms = [profile.partition("/")[0] for profile in self._profiles]
        if facts.kind is not None:
            terms.append(facts.kind)
        return search_text((self._robot.path, facts.vendor, facts.model), terms)

    def in_steps(
        self, rights: Rights, controllers: Controllers, running: Commanding
    ) -> Iterator[dict[str, Any] | None]:
        """Write it down."""
        facts, robot = self._facts, self._robot
        limits: dict[str, Any] = {}
        frames = dict.fromkeys(facts.frames)
        for number, member in enumerate(self._members, 1):
            if member.describes and member.limits:
                limits[member.entry.name] = member.limits
            frames |= dict.fromkeys(member.frames)
            if not number % _STEP:
                yield None
        moving = (member.entry for member in self._members if member.entry.moves)
        state = RobotState(
            path=robot.path,
            tenant=robot.tenant,
            state=_worst({unit.owner.name: unit.availability for unit in self._units}),
            estop=any(unit.latch is not None for unit in self._units),
            held=any(unit.is_held for unit in self._units),
            kind=facts.kind,
            profiles=self._profiles,
            vendor=facts.vendor,
            model=facts.model,
            firmware=facts.firmware,
            serial=facts.serial,
            mode=self._mode(rights),
            battery=self._reading(rights, _BATTERY),
            pose=self._reading(rights, _POSE),
            control=controllers.of(moving, running),
            fact_sheet=FactSheet(limits, facts.dimensions, tuple(frames)),
        )
        yield msgspec.to_builtins(state)

    def _mode(self, rights: Rights) -> str | None:
        reading = self._reading(rights, _MODE)
        return reading.value if reading is not None and isinstance(reading.value, str) else None

    def _reading(self, rights: Rights, name: str) -> Reading | None:
        """Return the latest sample of a resource that the reader may read."""
        for member in self._members:
            entry = member.entry
            if member.name != name or not rights.permits(entry, Operation.READ):
                continue
            if (sample := entry.latest) is None:
                continue
            try:
                value = to_plain(sample.value)
            except RcpError:  # the robot's fault, which the resource itself shows
                continue
            mark = _MARK.get(name)
            if mark is None or (isinstance(value, dict) and mark in value):
                return Reading(value, sample.time, entry.stale)
        return None


def _is_robot(unit: RobotUnit) -> bool:
    """Tell whether it is a robot, or all of a backend that is one; a fleet is none."""
    if unit.robot is not None:
        return True
    return unit in unit.owner.units and not unit.owner.has_gateways


def _facts_of(units: Iterable[RobotUnit]) -> RobotFacts:
    """Merge what several backends say of one robot; a part does not describe the whole."""
    told = {unit if unit.owner.robot is None else unit.whole: None for unit in units}
    merged: dict[str, Any] = {}
    for facts in (unit.facts for unit in told):
        for name in RobotFacts.__struct_fields__:
            if not merged.get(name):
                merged[name] = getattr(facts, name)
    return RobotFacts(**merged)


def _worst(states: dict[str, Availability]) -> Literal["starting", "ready", "degraded", "down"]:
    """Return the state of a robot with these backends: it is down if all of them are."""
    found = set(states.values())
    if len(found) == 1:
        return found.pop()
    return "degraded" if found & {"ready", "degraded"} else "starting"
