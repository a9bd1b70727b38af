"""Recognition of valid Structs: one expression, compiled for their type.

msgspec validates what it decodes, not what exists. A published Struct would have to be encoded and
decoded again to be validated, which takes twice as long as this expression. It covers Structs of
numbers, strings, enums and other such Structs, each of which may be None.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from enum import Flag
from keyword import iskeyword
from typing import Any

import msgspec
from msgspec import inspect as mi

from rcp_protocol.shape import SAFE_INTEGER

__all__ = ["InstanceCheck", "compile_check"]

InstanceCheck = Callable[[Any], bool]
"""Returns whether a value is certainly valid and JSON represents all of its numbers.

It may raise `AttributeError` if a field is not set."""

_LONGEST = 64  # fields; Structs with more are encoded and decoded
_NOT_MONOTONE = re.compile(r"\[\^|\\[A-Z0-9b]|\(\?[^:]|[*+?}]\+")
"""Finds what may match more in a pattern if its classes match less: complements, lookarounds, …"""
_LARGEST_FLOAT = sys.float_info.max


class _NotCoveredError(Exception):
    """A part of the type is not covered."""


def compile_check(type_: Any) -> InstanceCheck | None:
    """Return a function that recognises valid values of a type; None: the type is not covered."""
    if not isinstance(type_, type(msgspec.Struct)):
        return None
    expression = _Expression()
    try:
        condition = expression.of(mi.type_info(type_), "value")
    except _NotCoveredError:
        return None
    # Its text is made here: names of fields are identifiers, and all other data has names.
    # Python is faster to compare where it jumps by the result.
    source = f"lambda value: True if {condition} else False"
    check: InstanceCheck = eval(source, expression.names)  # noqa: S307
    return check


class _Expression:
    """A condition in Python on each part of a value, and the data that it names."""

    def __init__(self) -> None:
        self.names: dict[str, Any] = {}
        self._within: list[type] = []
        self._parts = 0

    def of(self, info: mi.Type, place: str) -> str:
        """Return the condition on the part at a place."""
        self._parts += 1
        if self._parts > _LONGEST:
            raise _NotCoveredError
        part = f"part{self._parts}"
        bare, optional = _bare(info)
        rest = "".join(f" and {condition}" for condition in self._rest(bare, part))
        if optional:
            return f"(({part} := {place}) is None or type({part}) is {self._class(bare)}{rest})"
        return f"type({part} := {place}) is {self._class(bare)}{rest}"

    def _name(self, data: Any) -> str:
        name = f"data{len(self.names)}"
        self.names[name] = data
        return name

    def _class(self, info: mi.Type) -> str:
        match info:
            case mi.StructType():
                return self._name(info.cls)
            case mi.EnumType() if not issubclass(info.cls, Flag):  # not every sum of flags is valid
                return self._name(info.cls)
            case mi.FloatType():
                return "float"
            case mi.IntType():
                return "int"
            case mi.StrType():
                return "str"
            case mi.BoolType():
                return "bool"
            case _:
                raise _NotCoveredError

    def _rest(self, info: mi.Type, part: str) -> Iterator[str]:
        """Yield the conditions on a part of the right class."""
        match info:
            case mi.StructType():
                yield from self._fields(info, part)
            case mi.FloatType():  # NaN is within no bounds
                yield from self._bounds(info, part, _LARGEST_FLOAT)
            case mi.IntType():
                yield from self._bounds(info, part, SAFE_INTEGER)
            case mi.StrType():
                yield from self._text(info, part)
            case _:
                pass

    def _fields(self, info: mi.StructType, part: str) -> Iterator[str]:
        if info.cls in self._within or hasattr(info.cls, "__post_init__"):
            raise _NotCoveredError
        self._within.append(info.cls)
        for field in info.fields:
            if not field.name.isidentifier() or iskeyword(field.name):
                raise _NotCoveredError
            yield self.of(field.type, f"{part}.{field.name}")
        self._within.pop()

    def _bounds(self, info: mi.FloatType | mi.IntType, part: str, largest: float) -> Iterator[str]:
        if info.multiple_of is not None:
            raise _NotCoveredError
        kind = type(largest)
        low = -largest if info.ge is None else max(-largest, kind(info.ge))
        high = largest if info.le is None else min(largest, kind(info.le))
        yield f"{low!r} <= {part} <= {high!r}"
        if info.gt is not None:
            yield f"{part} > {self._name(kind(info.gt))}"
        if info.lt is not None:
            yield f"{part} < {self._name(kind(info.lt))}"

    def _text(self, info: mi.StrType, part: str) -> Iterator[str]:
        for operator, length in ((">=", info.min_length), ("<=", info.max_length)):
            if length is not None:
                yield f"len({part}) {operator} {self._name(length)}"
        if info.pattern is not None:
            # In ASCII, `\d` takes half the time, and matches less: the rest is decoded.
            flags = re.NOFLAG if _NOT_MONOTONE.search(info.pattern) else re.ASCII
            search = self._name(re.compile(info.pattern, flags).search)
            yield f"{search}({part}) is not None"


def _bare(info: mi.Type) -> tuple[mi.Type, bool]:
    """Return a type without its annotations, and whether it may be None."""
    optional = False
    while isinstance(info, mi.Metadata | mi.UnionType):
        if isinstance(info, mi.Metadata):
            info = info.type
            continue
        others = [option for option in info.types if not isinstance(option, mi.NoneType)]
        if len(others) != 1:
            raise _NotCoveredError
        info, optional = others[0], True
    return info, optional
