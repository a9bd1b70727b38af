"""Messages of random values, of every type of `test_msgs`, and what they say as plain data."""

from __future__ import annotations

import importlib
import math
import random
import struct
from typing import Any

import msgspec

from rcp_ros2.idl import load

MESSAGES = sorted(
    name for name in dir(importlib.import_module("test_msgs.msg")) if name[0].isupper()
)


def theirs(value: Any) -> Any:
    """Turn a message of rclpy into lists, dictionaries and numbers."""
    if hasattr(value, "get_fields_and_field_types"):
        names = value.get_fields_and_field_types()
        return {name: theirs(getattr(value, name)) for name in names}
    if isinstance(value, bytes):  # one octet
        return value[0]
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [theirs(one) for one in value]
    return struct.pack("d", value) if isinstance(value, float) else value  # NaN equals itself so


def ours(value: Any) -> Any:
    """Turn a typed value into the same."""
    if isinstance(value, msgspec.Struct):
        return {name: ours(getattr(value, name)) for name in value.__struct_fields__}
    if isinstance(value, (list, tuple, bytes)):
        return [ours(one) for one in value]
    return struct.pack("d", value) if isinstance(value, float) else value


def message_class(name: str) -> Any:
    return getattr(importlib.import_module("test_msgs.msg"), name)


FINITE = (0.0, -0.0, -1.5, 1e-30, 3.0e38, 1 / 3)
ANY = (*FINITE, math.inf, -math.inf, math.nan)


def message(cls: Any, chance: random.Random, floats: tuple[float, ...] = ANY) -> Any:
    """Make a message of random values, as rclpy would have it."""
    made = cls()
    for name, slot in zip(cls.get_fields_and_field_types(), cls.SLOT_TYPES, strict=True):
        setattr(made, name, some(slot, chance, floats))
    return made


def some(slot: Any, chance: random.Random, floats: tuple[float, ...]) -> Any:
    kind = type(slot).__name__
    if kind == "BasicType":
        return number(slot.typename, chance, floats)
    if kind == "NamespacedType":
        return message(load("/".join((*slot.namespaces, slot.name))), chance, floats)
    if kind in ("Array", "BoundedSequence", "UnboundedSequence"):
        size = slot.size if kind == "Array" else chance.randrange(4)
        return [some(slot.value_type, chance, floats) for _ in range(size)]
    text = "".join(chance.choices("abc äöü ハロー 😀", k=chance.randrange(6)))
    return text[: getattr(slot, "maximum_size", None)]


def number(kind: str, chance: random.Random, floats: tuple[float, ...]) -> Any:
    if kind == "boolean":
        return chance.random() < 0.5
    if kind == "octet":
        return bytes((chance.randrange(256),))
    if kind in ("float", "double"):
        return chance.choice(floats)
    width = int(kind.lstrip("uint"))
    low, high = (0, 2**width - 1) if kind[0] == "u" else (-(2 ** (width - 1)), 2 ** (width - 1) - 1)
    return chance.choice((low, high, chance.randint(low, high)))
