"""One condition: a CEL expression over named values, compiled once.

A missing value makes the result unknown, unless the rest of the expression decides.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import datetime
from functools import lru_cache
from typing import Any

import structlog

from rcp_conditions.cost import ASSUMED, BUDGET, Size, cost, size_of
from rcp_conditions.expression import (
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
from rcp_protocol.errors import ConfigError

__all__ = ["CLOCK", "Condition", "ConditionTooCostly", "ConditionsMissing", "Ref", "condition"]

log = structlog.get_logger("rcp.conditions")
Ref = tuple[str, ...]
"""`sensor.battery.percentage` as a tuple; the registry knows which part names the resource."""

_VALUES = ("sensor", "actuator", "param", "event")
CLOCK: dict[str, Callable[[datetime], int]] = {
    "hour": lambda t: t.hour,
    "minute": lambda t: t.minute,
    "weekday": lambda t: t.weekday(),
}
"""The time values that conditions can use."""
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
_SHOWN = 500  # characters of a condition shown in an error message
_OWN = re.compile(r"v\d+_")  # the names of values in the engine


class ConditionTooCostly(ConfigError):
    """An evaluation could block the event loop."""

    remedy = (
        "Nest fewer comprehensions (all, exists, filter, map), or use shorter lists; or have the "
        "robot publish the result as one value."
    )


class ConditionsMissing(ConfigError):
    """Nothing is installed that evaluates conditions."""

    remedy = "Have the operator run `pip install 'rcp-gateway[conditions]'` on the gateway and restart it."


class Condition:
    """A compiled expression.

    :raises ConfigError: it is not valid CEL, or uses unknown names.
    :raises ConditionsMissing: nothing here evaluates CEL.
    :raises ConditionTooCostly: it exceeds a limit of length, depth or cost.
    """

    __slots__ = ("_afforded", "_names", "_program", "_tree", "_warned", "refs", "text", "times")

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
                f"its estimated cost is {spent} units, the limit is {BUDGET} (assuming "
                f"{ASSUMED} elements in "
                "each list of unknown length)",
                costly=True,
            )
        try:
            # Here: it is an extra, and imports a command line, which few gateways need at their start.
            from cel import compile as compile_cel

            self._program = compile_cel(write(self._tree))
        except ImportError as error:
            raise ConditionsMissing(
                f"the condition `{self._shown}` cannot be evaluated ({error}); try: "
                "pip install 'rcp-gateway[conditions]'"
            ) from None
        except Exception as error:
            raise self._wrong(_first_line(error)) from None
        self._afforded: dict[str, Size] = {}
        self._warned = False
        self.refs: tuple[Ref, ...] = tuple(r for r in self._names if r[0] != "time")
        """The values it needs, each as branch, resource and field."""
        self.times: tuple[Ref, ...] = tuple(r for r in self._names if r[0] == "time")

    def _named(self, node: Node, bound: frozenset[str]) -> Node:
        """Replace the full name of each value by a variable."""
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
                        f"'{variable}' is already in use; choose another variable name for `{name}`"
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
                f"unknown name '{root[:64]}'; refer to a value by its branch "
                "(sensor.battery.percentage, "
                'sensor["battery-1"]), `mode`, or time.hour, time.minute, time.weekday'
            )
        ref = ("sensor", "mode", *steps) if root == "mode" else (root, *steps)
        if root in ("action", "service"):
            raise self._wrong(f"'{root}' has no value; conditions can use {', '.join(_VALUES)}")
        if root == "time" and (len(steps) != 1 or steps[0] not in CLOCK):
            raise self._wrong("`time` has only time.hour, time.minute and time.weekday")
        if len(ref) < 2:
            raise self._wrong(
                f"'{root}' alone is not a value; write {root}.<resource>.<field>, or "
                f'{root}["<name>"] for a name with characters other than letters, digits and _'
            )
        return self._names.setdefault(ref, f"v{len(self._names)}_")

    def _wrong(self, why: str, *, costly: bool = False) -> ConfigError:
        kind = ConditionTooCostly if costly else ConfigError
        return kind(
            f"the condition `{self._shown}` is {'too costly' if costly else 'wrong'}: {why}"
        )

    @property
    def _shown(self) -> str:
        return self.text if len(self.text) <= _SHOWN else f"{self.text[:_SHOWN]}…"

    def excess(self, values: dict[Ref, Any]) -> str | None:
        """Return why values are too large to evaluate it; None if they are not."""
        # Scalars never cost more than assumed at compile time.
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
                f"its cost is {spent} units, the limit is {BUDGET}: {'.'.join(most)} has {many} "
                "elements now"
            )
        self._afforded = sizes
        return None

    def evaluate(self, values: dict[Ref, Any]) -> bool | None:
        """Evaluate over the known values; None if a missing value decides or a type does not fit.

        Also None if the values are so large that it could take longer than a few milliseconds.
        """
        why = self.excess(values)
        if why is not None:
            if not self._warned:
                self._warned = True
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
    """Return the segments of a value's name; None for another expression."""
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
    """Compile an expression; results and errors are cached.

    :raises ConfigError: as for `Condition`.
    """
    found = _read(text)
    if isinstance(found, ConfigError):
        raise type(found)(*found.args)
    return found
