"""Fields of a value by their names on the wire: `linear.x`, `joints.0.velocity`, `joints.*.velocity`.

The empty text is the value itself, `*` every element of a list or map.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import Any, cast

import msgspec
from msgspec import inspect as mi

from rcp_protocol.plain import is_index, is_map, is_sequence
from rcp_protocol.shape import children, facts_of

__all__ = ["Field", "Leaf", "inner"]

_NUMBERS = (mi.IntType, mi.FloatType, mi.AnyType)
_WORDS = (mi.StrType, mi.EnumType, mi.LiteralType, mi.BoolType, mi.IntType, mi.AnyType)


class Leaf(msgspec.Struct, frozen=True):
    """The facts of a field's type."""

    number: bool
    """It can be a number."""
    word: bool
    """It can be a text, a truth value, or one of some."""
    unit: str | None


class Field:
    """One field, or one of every element."""

    __slots__ = ("_steps", "several", "text")

    def __init__(self, text: str) -> None:
        self.text = text
        self._steps = tuple(text.split(".")) if text else ()
        self.several = "*" in self._steps

    def one(self, value: Any) -> Any:
        """Return the value of a field without `*`; None if it is missing."""
        try:
            return inner(value, self._steps)
        except LookupError:
            return None

    def every(self, value: Any) -> Iterable[tuple[str, Any]]:
        """Yield every position that the field matches with its value, None if missing."""
        if not self.several:
            return ((self.text, self.one(value)),)
        return _walk(value, self._steps, ())

    def leaf(self, type_: Any) -> Leaf | None:
        """Return the type's facts of the field, or None if it has no such field."""
        found = [mi.type_info(type_)]
        for step in self._steps:
            found = [child for info in found for child in _children(info, step)]
        bare = [leaf for info in found for leaf in _bare(info)]
        if not bare:
            return None
        return Leaf(
            number=any(isinstance(info, _NUMBERS) for info, _ in bare),
            word=any(isinstance(info, _WORDS) for info, _ in bare),
            unit=next((unit for _, unit in bare if unit is not None), None),
        )


def inner(value: Any, steps: Iterable[str]) -> Any:
    """Go into a value, a name or an index at a time.

    :raises LookupError: there is no such field.
    """
    for step in steps:
        value = _into(value, step)
    return value


def _walk(value: Any, steps: tuple[str, ...], done: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    for at, step in enumerate(steps):
        if step == "*":
            for name, item in _elements(value):
                yield from _walk(item, steps[at + 1 :], (*done, *steps[:at], name))
            return
        try:
            value = _into(value, step)
        except LookupError:
            value = None
    yield ".".join((*done, *steps)), value


def _elements(value: Any) -> Iterable[tuple[str, Any]]:
    if is_map(value):
        return [(str(key), item) for key, item in value.items()]
    if is_sequence(value) or isinstance(value, (set, frozenset)):
        return [(str(i), item) for i, item in enumerate(cast("Iterable[Any]", value))]
    return [("*", None)]


def _into(value: Any, step: str) -> Any:
    if isinstance(value, msgspec.Struct) or dataclasses.is_dataclass(value):
        return getattr(value, _attributes(type(value))[step])
    if is_map(value):
        return value[step]
    if is_sequence(value):
        if step in getattr(value, "_fields", ()):
            return getattr(value, step)
        if is_index(step):
            return value[int(step)]
    raise LookupError(step)


@lru_cache(maxsize=4096)
def _attributes(kind: Any) -> dict[str, str]:
    """Return the attribute of each field's name on the wire."""
    if issubclass(kind, msgspec.Struct):
        return dict(zip(kind.__struct_encode_fields__, kind.__struct_fields__, strict=True))
    names: Iterable[str] = getattr(kind, "__dataclass_fields__", ())
    return {name: name for name in names}


def _children(info: mi.Type, step: str) -> list[mi.Type]:
    if step != "*":
        return children(info, step)
    match info:
        case mi.Metadata():
            return _children(info.type, step)
        case mi.UnionType():
            return [child for option in info.types for child in _children(option, step)]
        case mi.DictType():
            return [info.value_type]
        case mi.ListType() | mi.VarTupleType() | mi.SetType() | mi.FrozenSetType():
            return [info.item_type]
        case mi.TupleType():
            return list(info.item_types)
        case mi.AnyType():
            return [info]
        case _:
            return []


def _bare(info: mi.Type, unit: str | None = None) -> Iterator[tuple[mi.Type, str | None]]:
    """Iterate over the possible types of a field, except null, with its unit."""
    match info:
        case mi.Metadata():
            yield from _bare(info.type, facts_of(info).get("unit", unit))
        case mi.UnionType():
            for option in info.types:
                yield from _bare(option, unit)
        case mi.NoneType():
            return
        case _:
            yield info, unit
