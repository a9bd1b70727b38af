"""Filters of samples: `where` and `deadband`, compiled to small functions that run for each sample.

They are not CEL: a filter names one field per comparison, and its cost is known without evaluating it.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from rcp_conditions.fields import Field
from rcp_protocol.errors import FilterUnsupported
from rcp_protocol.plain import is_list, is_map

__all__ = ["MAX_TERMS", "Change", "Deadband", "Where", "fields_of", "parse_where"]

MAX_TERMS = 64
"""Terms of a `where`; fields of a `deadband`, and of a projection."""
Deadband = float | str | dict[str, float | str]
Predicate = Callable[[Any], bool]


_COMPARE: dict[str, Callable[[Any, Any], bool]] = {
    "lt": operator.lt,
    "le": operator.le,
    "gt": operator.gt,
    "ge": operator.ge,
    "eq": operator.eq,
    "ne": operator.ne,
}


class Where:
    """A compiled `where`; with the last result if it fires on an edge."""

    __slots__ = ("_before", "edge", "holds")

    def __init__(self, holds: Predicate, edge: str | None) -> None:
        self.holds = holds
        self.edge = edge
        self._before: bool | None = None

    def passes(self, value: Any) -> bool:
        """Return whether a value passes; an edge requires an earlier value on the other side."""
        now = self.holds(value)
        if self.edge is None:
            return now
        before, self._before = self._before, now
        if before is None:
            return False
        if self.edge == "rise":
            return now and not before
        return before and not now if self.edge == "fall" else now != before

    def fresh(self) -> Where:
        """Return a copy without state: every path has its own edges."""
        return Where(self.holds, self.edge)


def parse_where(node: dict[str, Any]) -> Where:
    """Compile `{"field": …, "lt": …}` with `and`/`or`/`not`; `edge` is at the top level.

    :raises FilterUnsupported: the expression is invalid.
    """
    edge = node.get("edge")
    if edge not in (None, "rise", "fall", "both"):
        raise _bad("`edge` is one of rise, fall, both")
    rest = {key: item for key, item in node.items() if key != "edge"}
    budget = [MAX_TERMS]
    return Where(_predicate(rest, budget), edge)


def _bad(why: str) -> FilterUnsupported:
    return FilterUnsupported(
        f"`where` is malformed: {why}",
        remedy='Use {"field": "voltage", "lt": 11.1}, combined with {"and": […]}, {"or": […]}, '
        '{"not": …}; "edge": "rise" at the top level.',
    )


def _predicate(node: Any, budget: list[int]) -> Predicate:
    budget[0] -= 1
    if budget[0] < 0:
        raise _bad(f"it has more than {MAX_TERMS} terms")
    if not is_map(node) or not node:
        raise _bad("each term is an object")
    terms = [_term(key, item, node, budget) for key, item in node.items() if key != "field"]
    if not terms:
        raise _bad("a field has no comparison")
    return terms[0] if len(terms) == 1 else lambda value: all(term(value) for term in terms)


def _term(key: str, item: Any, node: dict[str, Any], budget: list[int]) -> Predicate:
    if key in ("and", "or"):
        if not is_list(item) or not item:
            raise _bad(f"`{key}` takes a list")
        parts = [_predicate(part, budget) for part in item]
        join = all if key == "and" else any
        return lambda value: join(part(value) for part in parts)
    if key == "not":
        inner = _predicate(item, budget)
        return lambda value: not inner(value)
    compare = _COMPARE.get(key)
    if compare is None:
        raise _bad(f"{key[:40]!r} is not one of {', '.join(_COMPARE)}, and, or, not, field, edge")
    field = node.get("field", "")
    if not isinstance(field, str):
        raise _bad("`field` is a text")
    return _comparison(Field(field).one, compare, item)


def _comparison(
    get: Callable[[Any], Any], compare: Callable[[Any, Any], bool], item: Any
) -> Predicate:
    def holds(value: Any) -> bool:
        actual = get(value)
        if actual is None and item is not None:
            return False
        try:
            return bool(compare(actual, item))
        except TypeError:
            return False

    return holds


def fields_of(where: dict[str, Any]) -> list[str]:
    """List the fields that an expression uses, to be checked against the type."""
    out: list[str] = []
    for key, item in where.items():
        if key == "field" and isinstance(item, str) and item:
            out.append(item)
        elif key in ("and", "or") and is_list(item):
            for part in item:
                out += fields_of(part) if is_map(part) else []
        elif key == "not" and is_map(item):
            out += fields_of(item)
    return out


class Change:
    """Whether a value differs enough from the last one that was sent."""

    __slots__ = ("_bands", "_get", "_last")

    def __init__(self, deadband: Deadband | None, fields: tuple[str, ...] | None) -> None:
        self._bands: dict[str, Callable[[float, float], bool]] | None = None
        if isinstance(deadband, (float, int, str)):
            self._bands = dict.fromkeys(fields or ("",), _band(deadband))
        elif deadband is not None:
            self._bands = {field: _band(size) for field, size in deadband.items()}
        looked_at = tuple(self._bands) if self._bands is not None else fields
        gets = [Field(f).one for f in looked_at] if looked_at else None
        self._get = gets
        self._last: Any = None

    def passes(self, value: Any) -> bool:
        """Return whether a value differs; if so, it becomes the new reference."""
        seen = value if self._get is None else [get(value) for get in self._get]
        last = self._last
        if last is not None and not self._differs(last, seen):
            return False
        self._last = seen
        return True

    def _differs(self, last: Any, seen: Any) -> bool:
        if self._bands is None:
            return last != seen
        pairs = zip(self._bands.values(), last, seen, strict=True)
        return any(_apart(band, old, new) for band, old, new in pairs)


def _apart(band: Callable[[float, float], bool], old: Any, new: Any) -> bool:
    numbers = isinstance(old, (int, float)) and isinstance(new, (int, float))
    return band(old, new) if numbers else old != new


def _band(size: float | str) -> Callable[[float, float], bool]:
    try:
        percent = isinstance(size, str)
        number = float(size.removesuffix("%")) if isinstance(size, str) else float(size)
        if (percent and not str(size).endswith("%")) or not (math.isfinite(number) and number >= 0):
            raise ValueError(size)
    except ValueError:
        raise FilterUnsupported(
            f"{str(size)[:40]!r} is not a deadband", remedy='Use a number, or "5%".'
        ) from None
    if percent:
        return lambda old, new: _beyond(old, new, abs(old) * number / 100)
    return lambda old, new: _beyond(old, new, number)


def _beyond(old: float, new: float, size: float) -> bool:
    if math.isfinite(old) and math.isfinite(new):
        return abs(new - old) >= size and new != old
    return old != new and not (math.isnan(old) and math.isnan(new))
