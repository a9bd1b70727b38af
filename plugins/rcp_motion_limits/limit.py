"""One motion limit on one path: its checks and error messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from enum import Enum
from typing import Any, NoReturn

import msgspec
from msgspec.structs import replace

from rcp_conditions import Condition, Ref, condition
from rcp_conditions.fields import Field
from rcp_kernel.access.acl import Rights
from rcp_kernel.errors import ModeForbids, OutOfRange, PreconditionFailed
from rcp_kernel.features import Robots
from rcp_kernel.model import Kind, Operation
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_motion_limits.commanded_values import CommandedValues
from rcp_motion_limits.config import Bound, EnvelopeConfig
from rcp_motion_limits.fence_check import FenceCheck
from rcp_motion_limits.own_pose import OwnPose

__all__ = ["MotionLimit", "within"]

_MODE: Ref = ("sensor", "mode")
_HEIGHT = "position.z"  # of a goal: null keeps the height, as in the profiles
_GOAL = (_HEIGHT, "position.x", "frame")
_LONGEST = 1.0  # s assumed between commands at most, if the path has no `valid_for`


class MotionLimit:
    """A table of the configuration, bound to the type of one path."""

    def __init__(self, table: EnvelopeConfig, entry: Entry, robots: Robots) -> None:
        self.table = table
        self.entry = entry
        self._now = entry.clock.monotonic
        self.bounds = [(Field(name), bound) for name, bound in table.bounds.items()]
        self.rates = [(Field(name), most) for name, most in table.rate.items()]
        self.fence = None if table.fence is None else FenceCheck(table.fence, entry, robots.entries)
        self.when = None if table.when is None else condition(table.when)
        self._conditions = robots.conditions
        called = entry.kind in (Kind.ACTION, Kind.SERVICE)
        self._type = entry.input_type if called else entry.value_type
        self._longest = entry.resource.valid_for or _LONGEST
        self.units: dict[str, str | None] = {}
        self.fault = self._find_fault()
        """Why the limit does not fit the path, so that every command is refused."""
        goal = called and all(Field(name).leaf(self._type.type) for name in _GOAL)
        self._height = table.bounds.get(_HEIGHT) if goal else None
        """The bound of a goal's height, which may be the one that the robot keeps."""
        kept = self._height is not None and not self._height.optional
        self._pose = OwnPose(entry, robots.entries) if kept else None

    def _find_fault(self) -> str | None:
        wanted = [(field, bool(bound.allow)) for field, bound in self.bounds]
        wanted += [(field, False) for field, _ in self.rates]
        if self.fence is not None and self.fence.sensor is None:
            wanted += [(field, False) for field in self.fence.point]
        for field, words in wanted:
            leaf = field.leaf(self._type.type)
            if leaf is None:
                return f"{self.entry.label} has no field '{field.text}'"
            if not (leaf.word if words else leaf.number):
                return (
                    f"{_named(field.text, self.entry)} is not a {'string' if words else 'number'}"
                )
            self.units[field.text] = leaf.unit
        return None

    @property
    def pose(self) -> str | None:
        """The path of the pose whose height is checked for commands that keep their height; None: none is."""
        return None if self._pose is None else self._pose.path

    @property
    def shown(self) -> Mapping[str, Bound]:
        """The bounds of what a client may send."""
        if self._height is None:
            return self.table.bounds
        return self.table.bounds | {_HEIGHT: replace(self._height, optional=True)}

    def check_value(self, session: Session, value: Any) -> None:
        """Refuse a value that is not allowed in any state of the robot.

        :raises OutOfRange: a field or the commanded position is outside its limits.
        """
        self._check_bounds(value)
        if self.fence is not None and self.fence.sensor is None:
            self._check_fence(session, self.fence, value)

    def check(self, session: Session, value: Any, force: CommandedValues) -> None:
        """Refuse a value that is not allowed now.

        :raises OutOfRange: a field, its rate of change or a position is outside its limits.
        :raises ModeForbids: the robot is in another mode.
        :raises PreconditionFailed: the condition is false or unknown.
        """
        if self.fault is not None:
            raise PreconditionFailed(
                f"the motion limits '{self.table.name}' do not fit this path: {self.fault}",
                path=self.entry.path,
                remedy="Ask the operator to correct [[envelopes]]; until then every command is "
                "refused.",
                details=self.facts(),
            )
        if self.table.modes:
            self._check_mode(session)
        if self.when is not None and self._conditions.holds(self.when, self.entry) is not True:
            self._refuse_condition(session, self.when)
        self._check_bounds(value)
        if self._pose is not None and self._height is not None:
            self._check_kept(session, value, self._pose, self._height)
        if self.fence is not None:
            self._check_fence(session, self.fence, value)
        for field, most in self.rates:
            for was in force.possible:
                step = most * min(max(0.0, self._now() - was.since), self._longest)
                self._check_change(field, field.every(value), field.every(was.value), most, step)

    # -- the limits ----------------------------------------------------------------------------

    def _check_bounds(self, value: Any) -> None:
        for field, bound in self.bounds:
            for name, found in field.every(value):
                if found is not None or bound is not self._height:
                    self._check_bound(name, found, bound, self.units[field.text])

    def _check_kept(self, session: Session, value: Any, pose: OwnPose, bound: Bound) -> None:
        """Refuse a goal without a height if the robot must not keep its own."""
        if Field(_HEIGHT).one(value) is not None:
            return
        height, about = pose.height(value.frame), {"field": _HEIGHT, "pointer": "/position/z"}
        if height is None:
            raise PreconditionFailed(
                f"{_named(_HEIGHT, self.entry)} is null, and the height that the robot keeps is "
                f"unknown{self.why}",
                path=self.entry.path,
                remedy="Name a height, or send it again when the robot reports its pose.",
                details={**about, **self.facts()},
            )
        if not within(height, bound):
            seen = session.rights.mask(pose.path) & Operation.READ
            text = f", {_text(round(height, 3))} m," if seen else ""
            shown = {"value": height} if seen else {}
            self._raise(
                f"{_named(_HEIGHT, self.entry)} is null, and the height that the robot keeps{text} "
                "exceeds the allowed range",
                allowed={"min": bound.min, "max": bound.max},
                **about,
                **shown,
            )

    def _check_bound(self, name: str, found: Any, bound: Bound, unit: str | None) -> None:
        if within(found, bound):
            return
        plain = found.value if isinstance(found, Enum) else found
        if plain is None:
            self._refuse(name, "is missing, so the robot would choose it", None, unit)
        if bound.allow:
            allowed = ", ".join(map(str, bound.allow))
            text = f"is {_shown(plain)}, allowed: {allowed}"
            self._refuse(name, text, plain, unit, allowed=list(bound.allow))
        if not _is_number(plain):
            self._refuse(name, "is not a finite number", plain, unit)
        above = bound.max is not None and plain > bound.max
        limit = bound.max if above else bound.min
        assert limit is not None
        broken, kept = (">", "<=") if above else ("<", ">=")
        tail = f" {unit}" if unit and unit != "1" else ""
        text = f"exceeds allowed range: {_shown(plain)} {broken} {_text(limit)}{tail}"
        self._refuse(name, text, plain, unit, bound=f"{kept} {_text(limit)}")

    def _check_change(
        self,
        field: Field,
        now: Iterable[tuple[str, Any]],
        before: Iterable[tuple[str, Any]],
        most: float,
        step: float,
    ) -> None:
        unit = self.units[field.text]
        found, known = dict(now), {name: n for name, n in before if _is_number(n)}
        for name, number in found.items():
            if not _is_number(number):
                self._refuse(name, "is not a finite number", number, unit)
        if known and known.keys() != found.keys():
            self._refuse(field.text, "has different elements than the current value", None, unit)
        for name, was in known.items():
            if abs(found[name] - was) > step:
                per = f"{_text(most)} {unit}/s" if unit and unit != "1" else f"{_text(most)}/s"
                self._refuse(
                    name,
                    f"changes too fast: from {was} to {found[name]} at {per} at most",
                    found[name],
                    unit,
                    rate=most,
                    allowed={"min": was - step, "max": was + step},
                )

    def _check_fence(self, session: Session, fence: FenceCheck, value: Any) -> None:
        if fence.sensor is None:
            where = fence.commanded(value)
            if where is None:
                self._refuse(fence.point[0].text, "has no position", None, None)
            frame = fence.foreign(value)
            if frame is not None:
                text = f"is given in the frame '{frame}', in which the fence is not known"
                self._refuse(fence.point[0].text, text, None, None)
            trouble = fence.trouble(*where)
            if trouble is not None:
                self._raise(
                    f"the position {_spot(where)} of {self.entry.label} {trouble[1]}",
                    value=list(where),
                    fence=trouble[0],
                    field=[field.text for field in fence.point],
                )
            return
        where = fence.present()
        if where is None:
            raise PreconditionFailed(
                f"the robot's position is unknown{self.why}",
                path=self.entry.path,
                remedy="Wait until the robot reports its position, then send it again.",
                details=self.facts(),
            )
        trouble = fence.trouble(*where)
        if trouble is not None:
            seen = session.rights.mask(fence.sensor) & Operation.READ
            facts = {"place": list(where), "of": fence.sensor} if seen else {}
            at = f" at {_spot(where)}" if seen else ""
            self._raise(f"the robot{at} {trouble[1]}", fence=trouble[0], **facts)

    def _check_mode(self, session: Session) -> None:
        found = self._conditions.values((_MODE,), self.entry).get(_MODE)
        if isinstance(found, str) and found in self.table.modes:
            return
        known = "its mode is unknown"
        facts: dict[str, Any] = {}
        if found is not None:
            known = "it is in a different mode"
            if self._may_read(session.rights, _MODE):
                known, facts = f"its mode is {_shown(found)}", {"mode": _plain(found)}
        wanted = ", ".join(self.table.modes)
        raise ModeForbids(
            f"{self.entry.path} accepts commands in mode {wanted}; {known}{self.why}",
            path=self.entry.path,
            details={"modes": list(self.table.modes), **facts, **self.facts()},
        )

    def _refuse_condition(self, session: Session, when: Condition) -> NoReturn:
        if not all(self._may_read(session.rights, ref) for ref in when.refs):
            raise PreconditionFailed(
                f"a condition for commands to {self.entry.path} does not hold{self.why}",
                path=self.entry.path,
                remedy="Ask the operator of the gateway which condition it is.",
                details=self.facts(),
            )
        values = self._conditions.values(when.refs, self.entry)
        known = {".".join(ref): values.get(ref) for ref in when.refs}
        listed = ", ".join(f"{n} is {'unknown' if v is None else v}" for n, v in known.items())
        raise PreconditionFailed(
            f"the condition {when.text} does not hold: {listed}{self.why}",
            path=self.entry.path,
            details={"condition": when.text, "values": known, **self.facts()},
        )

    def _may_read(self, rights: Rights, ref: Ref) -> bool:
        found = self._conditions.resource(ref, self.entry)
        return found is not None and bool(rights.mask(found[0].path) & Operation.READ)

    # -- descriptions ----------------------------------------------------------------------------

    def facts(self) -> dict[str, Any]:
        """Return the name of the limit for error details."""
        facts = {"envelope": self.table.name, "reason": self.table.reason}
        return {key: fact for key, fact in facts.items() if fact is not None}

    def describe(self, rights: Rights) -> dict[str, Any]:
        """Describe the limit; its condition only to those who may read the values."""
        plain = msgspec.to_builtins(self.table)
        keys = ("bounds", "rate", "fence", "modes")
        facts = {key: plain[key] for key in keys if plain[key]}
        fence = self.fence
        if fence and fence.sensor and not rights.mask(fence.sensor) & Operation.READ:
            facts["fence"].pop("of")
        if self.when is not None and all(self._may_read(rights, ref) for ref in self.when.refs):
            facts["when"] = self.when.text
        if self.fault is not None:
            facts["fault"] = self.fault
        return {**self.facts(), **facts}

    @property
    def why(self) -> str:
        """The reason in brackets, to end a sentence."""
        return f" ({self.table.reason})" if self.table.reason else ""

    def _refuse(self, name: str, text: str, found: Any, unit: str | None, **more: Any) -> NoReturn:
        pointer = "".join("/" + step for step in name.split(".")) if name else ""
        facts = {"field": name, "pointer": pointer, "value": _plain(found), "unit": unit, **more}
        self._raise(f"{_named(name, self.entry)} {text}", **facts)

    def _raise(self, text: str, **facts: Any) -> NoReturn:
        raise OutOfRange(
            f"{text}{self.why}",
            path=self.entry.path,
            remedy="Stay within the limits that `details.envelope` names; `discover` returns them.",
            details={**facts, **self.facts()},
        )


def within(found: Any, bound: Bound) -> bool:
    """Return whether a field may have a value; a non-finite number is in no range."""
    if found is None:
        return bound.optional
    if bound.allow:
        plain = found.value if isinstance(found, Enum) else found
        return any(_same(plain, allowed) for allowed in bound.allow)
    if not _is_number(found):
        return False
    return (bound.min is None or found >= bound.min) and (bound.max is None or found <= bound.max)


def _named(name: str, entry: Entry) -> str:
    return f"field '{name}' of {entry.label}" if name else entry.label


def _is_number(found: Any) -> bool:
    if isinstance(found, bool) or not isinstance(found, (int, float)):
        return False
    return math.isfinite(found)


def _same(found: Any, allowed: Any) -> bool:
    if isinstance(found, bool) or isinstance(allowed, bool):
        return found is allowed
    return found == allowed


def _plain(found: Any) -> Any:
    if found is None or isinstance(found, (str, bool)) or _is_number(found):
        return found
    return str(found)[:60]


def _shown(found: Any) -> str:
    return str(_plain(found))[:60]


def _text(number: float) -> str:
    return f"{number:.12g}"


def _spot(where: tuple[float, float]) -> str:
    return f"({_text(round(where[0], 3))}, {_text(round(where[1], 3))})"
