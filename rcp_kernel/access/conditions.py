"""Conditions over the state of a robot: CEL expressions of rules, envelopes and preconditions.

A name such as `sensor.battery.percentage` means the robot of whatever is asked for. What cannot
be known (never seen, stale, gone, of another type) makes the whole unknown unless the rest of the
expression decides without it.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable
from datetime import datetime
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import cel
import msgspec
import structlog

from rcp_kernel._plain import is_index, is_map, is_sequence
from rcp_kernel.access.cost import ASSUMED, BUDGET, Size, cost, size_of
from rcp_kernel.access.expression import (
    Call,
    ExpressionError,
    Index,
    ListLiteral,
    Literal,
    Macro,
    MapLiteral,
    Name,
    Node,
    Select,
    parse,
    write,
)
from rcp_kernel.access.pace import Allowance
from rcp_kernel.errors import ConfigError, RcpError
from rcp_kernel.model import full_path
from rcp_kernel.values import to_plain

if TYPE_CHECKING:
    from rcp_kernel.registry import Entry, Registry
    from rcp_kernel.streaming.hub import Hub

__all__ = ["Condition", "ConditionTooCostly", "Conditions", "Placed", "Ref", "condition"]

log = structlog.get_logger("rcp.conditions")
RATE = 5.0
"""Hz at which the resources are watched that conditions name."""

Ref = tuple[str, ...]
"""`sensor.battery.percentage` as a tuple; which of it is the resource, the registry tells."""

_VALUES = ("sensor", "actuator", "param", "event")
_CLOCK: dict[str, Callable[[datetime], int]] = {
    "hour": lambda t: t.hour,
    "minute": lambda t: t.minute,
    "weekday": lambda t: t.weekday(),
}
_ROOTS = (*_VALUES, "action", "service", "time", "mode")
_FUNCTIONS = frozenset(
    re.findall(
        r"\w+",
        "bytes contains double duration dyn endsWith getDate getDayOfMonth getDayOfWeek "
        "getDayOfYear getFullYear getHours getMilliseconds getMinutes getMonth getSeconds int "
        "has matches size startsWith string timestamp type uint",
    )
)
_STEP = re.compile(r"'[^'\\\n]*'|\"[^\"\\\n]*\"")
_SCALARS = (float, int, bool, type(None))
_FLOATS = {float, bool}
_SHOWN = 500  # characters of a condition in the message that refuses it
_OWN = re.compile(r"v\d+_")  # the names that values get in the engine


class ConditionTooCostly(ConfigError):
    """An evaluation could hold everybody else up."""

    remedy = (
        "Write fewer comprehensions (all, exists, filter, map) within each other, or over shorter "
        "lists; have the robot say as one value what the condition is to find out."
    )


class Placed(Protocol):
    """What belongs to a robot: an entry, or a step of a plan."""

    @property
    def tenant(self) -> str | None:
        """Whose it is."""
        ...

    @property
    def robot(self) -> str | None:
        """The robot's name, if it has one."""
        ...


class Condition:
    """A compiled expression.

    :raises ConfigError: it is not CEL, or names what is not there.
    :raises ConditionTooCostly: it is longer, deeper or dearer than a condition may be.
    """

    __slots__ = ("_afforded", "_names", "_program", "_told", "_tree", "refs", "text", "times")

    def __init__(self, text: str) -> None:
        self.text = text
        self._names: dict[Ref, str] = {}
        try:
            tree, _ = parse(text)
            self._tree = self._named(tree, frozenset())
            spent = cost(self._tree, {})
        except ExpressionError as error:
            raise self._wrong(str(error), costly=error.excess) from None
        if spent > BUDGET:
            raise self._wrong(
                f"it would cost {spent} units of {BUDGET} at most, with {ASSUMED} elements in "
                "each list of unknown length",
                costly=True,
            )
        try:
            self._program = cel.compile(write(self._tree))
        except Exception as error:
            raise self._wrong(_first_line(error)) from None
        self._afforded: dict[str, Size] = {}
        self._told = False
        self.refs: tuple[Ref, ...] = tuple(r for r in self._names if r[0] != "time")
        """The values it needs, each as branch, resource and field."""
        self.times: tuple[Ref, ...] = tuple(r for r in self._names if r[0] == "time")

    def _named(self, node: Node, bound: frozenset[str]) -> Node:
        """Put one variable in the place of each value's whole name."""
        steps = _chain(node)
        if steps is not None and steps[0] not in bound:
            return Name(self._name(steps))
        match node:
            case Select(of, field):
                return Select(self._named(of, bound), field)
            case Index(of, at):
                return Index(self._named(of, bound), self._named(at, bound))
            case Macro(name, range_, variable, body):
                if variable in _ROOTS or _OWN.fullmatch(variable):
                    raise self._wrong(
                        f"'{variable}' is taken; give what `{name}` goes over another"
                    )
                inner = bound | {variable}
                parts = tuple(self._named(part, inner) for part in body)
                return Macro(name, self._named(range_, bound), variable, parts)
            case Call(name, operands, form):
                if form in ("function", "method") and name not in _FUNCTIONS:
                    raise self._wrong(f"there is no function '{name[:64]}'")
                return Call(name, tuple(self._named(one, bound) for one in operands), form)
            case ListLiteral(items):
                return ListLiteral(tuple(self._named(item, bound) for item in items))
            case MapLiteral(items):
                return MapLiteral(tuple(self._named(item, bound) for item in items))
            case _:
                return node

    def _name(self, chain: Ref) -> str:
        root, *steps = chain
        if root not in _ROOTS:
            raise self._wrong(
                f"there is no '{root[:64]}'; name a value by its branch (sensor.battery.percentage, "
                'sensor["battery-1"]), `mode`, or time.hour, time.minute, time.weekday'
            )
        ref = ("sensor", "mode", *steps) if root == "mode" else (root, *steps)
        if root in ("action", "service"):
            raise self._wrong(f"'{root}' has no value; conditions are about {', '.join(_VALUES)}")
        if root == "time" and (len(steps) != 1 or steps[0] not in _CLOCK):
            raise self._wrong("of the time there are time.hour, time.minute and time.weekday")
        if len(ref) < 2:
            raise self._wrong(
                f"'{root}' alone is no value; write {root}.<resource>.<field>, and "
                f'{root}["<name>"] for a name with other characters than letters, digits and _'
            )
        return self._names.setdefault(ref, f"v{len(self._names)}_")

    def _wrong(self, why: str, *, costly: bool = False) -> ConfigError:
        kind = ConditionTooCostly if costly else ConfigError
        shown = self.text if len(self.text) <= _SHOWN else f"{self.text[:_SHOWN]}…"
        return kind(f"the condition `{shown}` is {'too costly' if costly else 'wrong'}: {why}")

    def excess(self, values: dict[Ref, Any]) -> str | None:
        """Say why values are too large for it, so that it is not evaluated; None: they are not."""
        # Scalars cost no more than what was assumed when it was compiled.
        large = {ref: value for ref, value in values.items() if not isinstance(value, _SCALARS)}
        if not large:
            return None
        sizes: dict[str, Size] = {}
        for ref, value in large.items():
            size = size_of(value)
            if size is None:
                return f"{'.'.join(ref)} is too large"
            sizes[self._names[ref]] = size
        if sizes == self._afforded:
            return None
        spent = cost(self._tree, sizes)
        if spent > BUDGET:
            most = max(large, key=lambda ref: sizes[self._names[ref]].total)
            many = sizes[self._names[most]].width
            return (
                f"it would cost {spent} units of {BUDGET} at most: {'.'.join(most)} has {many} "
                "elements now"
            )
        self._afforded = sizes
        return None

    def evaluate(self, values: dict[Ref, Any]) -> bool | None:
        """Evaluate over known values; None: what is missing decides, or a type does not fit.

        So it is where the values are so large that it could take longer than a few milliseconds.
        """
        why = self.excess(values)
        if why is not None:
            if not self._told:
                self._told = True
                log.warning("condition_too_costly", condition=self.text, reason=why)
            return None
        names = self._names
        try:
            result = self._program.execute({names[ref]: value for ref, value in values.items()})
        except Exception:
            return None
        except BaseException as error:
            if type(error).__name__ != "PanicException":  # a bug of the engine decides nothing
                raise
            return None
        return result if isinstance(result, bool) else None

    def __repr__(self) -> str:
        return f"Condition({self.text!r})"


def _first_line(error: Exception) -> str:
    text = str(error).partition("\n")[0]
    return text.rpartition("ERROR: ")[2][:200] or type(error).__name__


def _chain(node: Node) -> Ref | None:
    """Return a value's name as its steps; None: it is something else."""
    steps: list[str] = []
    while True:
        match node:
            case Name(name):
                return (name, *reversed(steps))
            case Select(of, field):
                node, step = of, field
            case Index(of, Literal(text)) if _STEP.fullmatch(text):
                node, step = of, text[1:-1]
            case _:
                return None
        steps.append(step)


@lru_cache(maxsize=1024)
def _read(text: str) -> Condition | ConfigError:
    try:
        return Condition(text)
    except ConfigError as error:
        return error.with_traceback(None)


def condition(text: str) -> Condition:
    """Compile an expression once; what is wrong with one is found out once, too.

    :raises ConfigError: as `Condition` does.
    """
    found = _read(text)
    if isinstance(found, ConfigError):
        raise type(found)(*found.args)
    return found


class Conditions:
    """Evaluates conditions from the registry's latest samples, and keeps those coming."""

    def __init__(
        self, hub: Hub, today: Callable[[], datetime] = lambda: datetime.now().astimezone()
    ) -> None:
        self._hub = hub
        self._registry: Registry = hub.registry
        self._today = today
        self.allowance = Allowance()
        """Of principals that send conditions."""
        self._used: dict[str, frozenset[str]] = {}
        self._names: Counter[str] = Counter()
        """Names of resources, each with how many parts need it."""
        self._registry.on_added.append(self._added)

    def use(self, part: str, conditions: Iterable[Condition]) -> None:
        """Keep watched what a part of the configuration needs from now on, in place of before."""
        refs = {ref for one in conditions for ref in one.refs}
        wanted = frozenset(name for ref in refs for name in _candidates(ref))
        before = self._used.pop(part, frozenset[str]())
        if wanted:
            self._used[part] = wanted
        self._names.update(wanted - before)
        self._names.subtract(before - wanted)
        # Plans begin and end by the dozen: only what nobody or nobody else needs is looked for.
        changed = {n for n in wanted - before if self._names[n] == 1}
        for name in before - wanted:
            if not self._names[name]:
                del self._names[name]
                changed.add(name)
        if changed:
            for entry in self._registry.entries.values():
                if entry.name in changed:
                    self._added(entry)

    def _added(self, entry: Entry) -> None:
        self._hub.sustain(entry, RATE if entry.name in self._names and not entry.live else 0.0)

    def holds(self, condition: Condition, placed: Placed) -> bool | None:
        """Tell whether a condition holds for a robot; None: it cannot be known."""
        values = self.values(condition.refs, placed)
        if condition.times:
            moment = self._today()
            for ref in condition.times:
                values[ref] = _CLOCK[ref[1]](moment)
        return condition.evaluate(values)

    def excess(self, condition: Condition, placed: Placed) -> str | None:
        """Say why a condition is not evaluated for a robot: its values are too large for that."""
        for ref in condition.refs:
            found = self.resource(ref, placed)
            if found is not None and self._known(found[0]) and _too_large(*found):
                return f"{'.'.join(ref)} is too large"
        return condition.excess(self.values(condition.refs, placed))

    def values(self, refs: Iterable[Ref], placed: Placed) -> dict[Ref, Any]:
        """Return what names stand for now, for a robot; not what is unknown."""
        values: dict[Ref, Any] = {}
        for ref in refs:
            found = self.resource(ref, placed)
            if found is not None and self._known(found[0]):
                self._look(values, ref, *found)
        return values

    def resource(self, ref: Ref, placed: Placed) -> tuple[Entry, Ref] | None:
        """Find what a name means for a robot: the resource, and the field in it."""
        if placed.tenant is None:
            return None
        for name in _candidates(ref):
            found = self._registry.entries.get(full_path(placed.tenant, placed.robot, name))
            if found is not None:
                return found, ref[name.count("/") + 1 :]
        return None

    def _known(self, entry: Entry) -> bool:
        return not entry.stale and (
            entry.live or entry.kind == "actuator" or self._hub.demand.holds(entry)
        )

    @staticmethod
    def _look(values: dict[Ref, Any], ref: Ref, entry: Entry, field: Ref) -> None:
        assert entry.latest is not None
        try:
            raw = _inner(entry.latest.value, field)
            if size_of(raw) is None:  # before it is copied
                return
            value = to_plain(raw)
        except (RcpError, LookupError, TypeError, ValueError):
            return
        if _finite(value):
            values[ref] = value


def _too_large(entry: Entry, field: Ref) -> bool:
    assert entry.latest is not None
    try:
        return size_of(_inner(entry.latest.value, field)) is None
    except LookupError:
        return False


def _candidates(ref: Ref) -> list[str]:
    """List the resources that a name may mean, the longest first."""
    return ["/".join(ref[:length]) for length in range(len(ref), 1, -1)]


def _inner(value: Any, field: Ref) -> Any:
    """Go into a value.

    :raises LookupError: there is no such field.
    """
    for name in field:
        if isinstance(value, msgspec.Struct):
            if name not in value.__struct_fields__:
                raise LookupError(name)
            value = getattr(value, name)
        elif is_map(value):
            value = value[name]
        elif is_sequence(value) and is_index(name):
            value = value[int(name)]
        else:
            raise LookupError(name)
    return value


def _finite(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, list):
        kinds = set(map(type, value))  # pyright: ignore[reportUnknownArgumentType]
        if kinds <= _FLOATS:  # a long one is most often such
            return all(map(math.isfinite, value))  # pyright: ignore[reportUnknownArgumentType]
        return all(map(_finite, value))  # pyright: ignore[reportUnknownArgumentType]
    if is_map(value):
        return all(map(_finite, value.values()))
    return True
