"""Conditions over the state of a robot: CEL expressions of rules, envelopes and preconditions.

A name such as `sensor.battery.percentage` means the robot of whatever is asked for. What cannot
be known (never seen, stale, gone, of another type) makes the whole unknown unless the rest of the
expression decides without it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from datetime import datetime
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import cel
import msgspec

from rcp_kernel._plain import is_index, is_map, is_sequence
from rcp_kernel.errors import ConfigError, RcpError
from rcp_kernel.model import full_path
from rcp_kernel.values import to_plain

if TYPE_CHECKING:
    from rcp_kernel.registry import Entry, Registry
    from rcp_kernel.streaming.hub import Hub

__all__ = ["Condition", "Conditions", "Placed", "Ref", "condition"]

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
_MACROS = ("all", "exists", "exists_one", "filter", "map")
_FUNCTIONS = frozenset(
    re.findall(
        r"\w+",
        "bytes contains double duration dyn endsWith getDate getDayOfMonth getDayOfWeek "
        "getDayOfYear getFullYear getHours getMilliseconds getMinutes getMonth getSeconds int "
        "matches size startsWith string timestamp type uint",
    )
)
_STRING = (
    r"[bB]?[rR][bB]?(?:'''.*?'''|\"\"\".*?\"\"\"|'[^'\n]*'|\"[^\"\n]*\")"
    r"|[bB]?(?:'''(?:\\.|[^\\])*?'''|\"\"\"(?:\\.|[^\\])*?\"\"\""
    r"|'(?:\\.|[^'\\\n])*'|\"(?:\\.|[^\"\\\n])*\")"
)
_STEP = r"\s*\.\s*[A-Za-z_]\w*+(?!\s*\()|\s*\[\s*(?:'[^'\\\n]*'|\"[^\"\\\n]*\")\s*\]"
_TOKEN = re.compile(
    rf"(?P<skip>{_STRING}|//[^\n]*|\.\s*[A-Za-z_]\w*+|(?:\d|\.\d)[\w.]*+)"
    rf"|\b(?P<root>{'|'.join(_ROOTS)})\b(?P<steps>(?:{_STEP})*)"
    r"|[A-Za-z_]\w*+",
    re.DOTALL,
)
_PART = re.compile(r"[A-Za-z_]\w*|'[^']*'|\"[^\"]*\"")
_BINDS = re.compile(rf"\.\s*(?:{'|'.join(_MACROS)})\s*\(\s*([A-Za-z_]\w*)\s*,")


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
    """

    __slots__ = ("_names", "_program", "refs", "text", "times")

    def __init__(self, text: str) -> None:
        self.text = text
        self._names: dict[Ref, str] = {}
        plain = _TOKEN.sub(self._name, text)
        try:
            self._program = cel.compile(plain)
            said = self._program.references()
        except Exception as error:
            raise self._wrong(_first_line(error)) from None
        known = {*self._names.values(), *_BINDS.findall(text)}
        for name in said["variables"]:
            if name not in known:
                raise self._wrong(
                    f"there is no '{name}'; name a value by its branch (sensor.battery.percentage, "
                    'sensor["battery-1"]), `mode`, or time.hour, time.minute, time.weekday'
                )
        for name in said["functions"]:
            if name.isidentifier() and name not in _FUNCTIONS:
                raise self._wrong(f"there is no function '{name}'")
        self.refs: tuple[Ref, ...] = tuple(r for r in self._names if r[0] != "time")
        """The values it needs, each as branch, resource and field."""
        self.times: tuple[Ref, ...] = tuple(r for r in self._names if r[0] == "time")

    def _name(self, match: re.Match[str]) -> str:
        """Put one variable in the place of each value's whole name."""
        root = match["root"]
        if root is None:
            return match[0]
        steps = [part.strip("'\"") for part in _PART.findall(match["steps"])]
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

    def _wrong(self, why: str) -> ConfigError:
        return ConfigError(f"the condition `{self.text}` is wrong: {why}")

    def evaluate(self, values: dict[Ref, Any]) -> bool | None:
        """Evaluate over known values; None: what is missing decides, or a type does not fit."""
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


@lru_cache(maxsize=1024)
def condition(text: str) -> Condition:
    """Compile an expression once.

    :raises ConfigError: as `Condition` does.
    """
    return Condition(text)


class Conditions:
    """Evaluates conditions from the registry's latest samples, and keeps those coming."""

    def __init__(
        self, hub: Hub, today: Callable[[], datetime] = lambda: datetime.now().astimezone()
    ) -> None:
        self._hub = hub
        self._registry: Registry = hub.registry
        self._today = today
        self._used: dict[str, tuple[Condition, ...]] = {}
        self._names: frozenset[str] = frozenset()
        self._registry.on_added.append(self._added)

    def use(self, part: str, conditions: Iterable[Condition]) -> None:
        """Keep watched what a part of the configuration needs from now on, in place of before."""
        self._used[part] = tuple(conditions)
        if not self._used[part]:
            del self._used[part]
        refs = {ref for used in self._used.values() for one in used for ref in one.refs}
        self._names = frozenset(name for ref in refs for name in _candidates(ref))
        for entry in self._registry.entries.values():
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
            entry.live or entry.kind == "actuator" or self._hub.watches.holds(entry)
        )

    @staticmethod
    def _look(values: dict[Ref, Any], ref: Ref, entry: Entry, field: Ref) -> None:
        assert entry.latest is not None
        try:
            value = to_plain(_inner(entry.latest.value, field))
        except (RcpError, LookupError, TypeError, ValueError):
            return
        if _finite(value):
            values[ref] = value


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
        return all(map(_finite, value))  # pyright: ignore[reportUnknownArgumentType]
    if is_map(value):
        return all(map(_finite, value.values()))
    return True
