"""Conversion of typed values to ROS messages, for publishing, requests and goals.

The generated classes check nothing by default and their C code trusts its input, so each value is
given exactly the Python type that rosidl expects.
"""

from __future__ import annotations

import array
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from rcp_ros2.idl import WIDTHS, Primitive, Ref, Sequence, Text, Type, fields_of
from rcp_ros2.types import is_bytes

__all__ = ["filler"]

Fill = Callable[[Any], Any]


@lru_cache(maxsize=4096)
def filler(cls: Any) -> Fill:
    """Return a function that converts a typed value to a message of a class."""
    steps = [(field.name, _converter(field.type)) for field in fields_of(cls)]

    def fill(value: Any) -> Any:
        message = cls()
        for name, convert in steps:
            setattr(message, name, convert(getattr(value, name)))
        return message

    return fill


def _converter(type_: Type) -> Fill:
    match type_:
        case Primitive("octet"):
            return lambda value: bytes((value,))
        case Primitive("bool"):
            return bool
        case Primitive("float32" | "float64"):
            return float
        case Primitive():
            return int
        case Text():
            return _text
        case Ref(cls):
            return filler(cls)
        case Sequence(item, size, _):
            return _many(item, fixed=size is not None)


def _text(value: str) -> str:
    # C strings end at NUL, and lone surrogates cannot be encoded: neither may truncate a text.
    return value.replace("\0", "").encode("utf-8", "replace").decode()


def _many(item: Type, *, fixed: bool) -> Fill:
    if item == Primitive("octet"):
        return lambda value: [bytes((one,)) for one in value]
    if isinstance(item, Primitive) and item.name != "bool":
        if fixed:  # numpy arrays accept any list of numbers
            return list
        letter = WIDTHS[item.name][0]
        if is_bytes(item):
            return lambda value: array.array("B", bytes(value))
        return lambda value: array.array(letter, value)
    one = _converter(item)
    return lambda value: [one(v) for v in value]
