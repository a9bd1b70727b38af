"""Cost of a condition, estimated from its syntax tree before the engine runs it.

The engine has no limit and cannot be interrupted, so its work is bounded beforehand, as Kubernetes
does for its rules: each comprehension multiplies the cost of its body by the length of its list. A
unit is about 0.1 µs of the engine, measured on a slow core. The formulas reflect that the engine
copies the value of every name, and that `map` and `filter` copy their results for each element,
which makes them quadratic.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple

import msgspec

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
)

__all__ = ["ASSUMED", "BUDGET", "Size", "cost", "size_of"]

BUDGET = 40_000
"""Maximum cost of an evaluation: about 4 ms."""
ASSUMED = 50
"""Assumed size of a value that is not known yet."""
_LARGEST = BUDGET // 3  # elements of a value; more would exceed the budget by themselves
_SLOW = 3  # cost in elements of an element that must be inspected individually
_DEEPEST = 32  # levels of a value
_TEXT = 32  # bytes of text that cost as much as an element
_REPEATS = re.compile(r"\{\s*(\d*)\s*(?:,\s*(\d*)\s*)?\}")
_CLASSES = (
    (4000, re.compile(r"\\[wWpPxuU]|[^\x00-\x7f]")),  # a large class takes 0.3 ms to compile
    (700, re.compile(r"\\[dD]")),
    (80, re.compile(r"\\[sSbB]|\[|\.")),
)
"""Cost of character classes in a regular expression, which is compiled at each evaluation."""
_SCALARS = (float, int, bool, type(None))
_FLAT = {float, int, bool}
_PATTERN = 200  # characters of a regular expression


class Size(NamedTuple):
    """The maximum size of a value."""

    width: int
    """Elements that a comprehension over it visits."""
    total: int
    """Elements on all levels, including text by its length."""
    largest: int
    """Total of its largest element."""

    @property
    def element(self) -> Size:
        """The size of its elements."""
        return Size(self.largest, self.largest, self.largest)


_ONE = Size(1, 1, 1)
_UNKNOWN = Size(ASSUMED, ASSUMED, 1)
_PASSING = frozenset(["?:", "||", "&&", "+", "-", "*", "string", "bytes", "dyn"])
"""Operators and functions whose result may be as large as their operands."""


def cost(tree: Node, sizes: Mapping[str, Size]) -> int:
    """Estimate the maximum cost of an evaluation; a name without a size counts as `ASSUMED`.

    :raises ExpressionError: the cost is not bounded.
    """
    return _weigh(tree, dict(sizes))[0] + sum(2 * size.total for size in sizes.values())


def _weigh(node: Node, sizes: dict[str, Size]) -> tuple[int, Size]:
    """Return the cost of a node and the size of its value."""
    # One function, to use few Python stack frames per level of the tree.
    match node:
        case Literal(text):
            total = 1 + len(text) // _TEXT
            return 1, Size(total, total, 1)
        case Name(name):
            size = sizes.get(name, _UNKNOWN)
            return 1 + size.total, size
        case Select(of, _):
            spent, size = _weigh(of, sizes)
            return spent + 1 + size.total, size.element
        case Index(of, at):
            spent, size = _weigh(of, sizes)
            return spent + _weigh(at, sizes)[0] + 1 + size.total, size.element
        case Macro():
            return _weigh_macro(node, sizes)
        case ListLiteral(items) | MapLiteral(items) | Call(_, items, _):
            parts = [_weigh(item, sizes) for item in items]
            return _weigh_several(node, parts)


def _weigh_several(
    node: ListLiteral | MapLiteral | Call, parts: list[tuple[int, Size]]
) -> tuple[int, Size]:
    spent, total = sum(part[0] for part in parts), sum(part[1].total for part in parts)
    spent += 1 + total // 4
    if not isinstance(node, Call):
        largest = max((part[1].total for part in parts), default=1)
        return spent, Size(len(parts), total + len(parts), largest)
    if node.name == "matches":
        spent += _weigh_pattern(node, parts[0][1].total if parts else 1)
    if node.name not in _PASSING:
        return spent, _ONE
    width = sum(part[1].width for part in parts)
    return spent, Size(width, total, max(part[1].largest for part in parts))


def _weigh_macro(node: Macro, sizes: dict[str, Size]) -> tuple[int, Size]:
    spent, range_ = _weigh(node.range, sizes)
    width, element = range_.width, range_.element
    parts = [_weigh(part, {**sizes, node.variable: element}) for part in node.body]
    spent += width * (3 + sum(part[0] for part in parts))
    if node.name not in ("map", "filter"):
        return spent, _ONE
    kept = 1 + (parts[-1][1] if node.name == "map" else element).total
    return spent + width * width * kept, Size(width, width * kept, kept)


def _weigh_pattern(node: Call, text: int) -> int:
    """Estimate a match: the pattern is compiled each time, then run over the text.

    :raises ExpressionError: the pattern is not a literal, or is too long.
    """
    pattern = node.operands[1] if len(node.operands) > 1 else None
    if not isinstance(pattern, Literal) or pattern.text[-1] not in "'\"":
        why = "the pattern of `matches` must be a string literal"
        raise ExpressionError(why, excess=True)
    states = len(pattern.text)
    if states > _PATTERN:
        why = f"the pattern of `matches` has more than {_PATTERN} characters"
        raise ExpressionError(why, excess=True)
    classes = sum(units * len(found.findall(pattern.text)) for units, found in _CLASSES)
    repeats = [max(1, int(low or 0), int(high or 0)) for low, high in _repeats(pattern.text)]
    # Repeated groups multiply the cost of their contents.
    times = math.prod(repeats) if "){" in pattern.text else max(repeats, default=1)
    return times * (states + classes + 2 * text * states)


def _repeats(pattern: str) -> list[tuple[str, str]]:
    found = _REPEATS.findall(pattern)
    if any(len(low) > 5 or len(high) > 5 for low, high in found):
        raise ExpressionError("the pattern of `matches` repeats too often", excess=True)
    return found


def size_of(value: Any) -> Size | None:
    """Measure a value; None if it is too large or too deep for any condition."""
    if isinstance(value, _SCALARS):
        return _ONE
    room = [_LARGEST]
    largest = _count(value, room, _DEEPEST)
    if largest is None:
        return None
    long = isinstance(value, (list, tuple, dict))
    width = len(value) if long else 1  # pyright: ignore[reportUnknownArgumentType]
    return Size(width, _LARGEST - room[0], max(1, largest))


def _count(value: Any, room: list[int], depth: int) -> int | None:
    """Subtract a value's elements from `room`; return the size of its largest element."""
    room[0] -= 1
    if isinstance(value, _SCALARS):
        return None if room[0] < 0 else 0
    if isinstance(value, (str, bytes, bytearray, memoryview)):
        length = value.nbytes if isinstance(value, memoryview) else len(value)
        room[0] -= length // _TEXT
        return None if room[0] < 0 else 0
    items = _items(value)
    if len(items) > room[0] or not depth:
        return None
    if set(map(type, items)) <= _FLAT:  # by far the most frequent case, and the longest lists
        room[0] -= len(items)
        return 1
    largest = 0
    for item in items:
        before = room[0]
        room[0] -= _SLOW
        if _count(item, room, depth - 1) is None:
            return None
        largest = max(largest, before - room[0])
    return largest


def _items(value: Any) -> Collection[Any]:
    if isinstance(value, (list, tuple, set, frozenset)):
        return value  # pyright: ignore[reportUnknownVariableType]
    if isinstance(value, dict):
        return [*value, *value.values()]  # pyright: ignore[reportUnknownVariableType]
    if isinstance(value, msgspec.Struct):
        return [getattr(value, name) for name in value.__struct_fields__]
    if is_dataclass(value):
        return [getattr(value, field.name) for field in fields(value)]
    return ()
