"""What a message class says about its fields, in five words of our own.

rosidl's generated classes describe themselves (`SLOT_TYPES`). Types, decoder and filler are all
made from this one description, so that they agree.
"""

from __future__ import annotations

import importlib
from functools import lru_cache
from typing import Any, NamedTuple

__all__ = [
    "WIDTHS",
    "Field",
    "MissingType",
    "Primitive",
    "Ref",
    "Sequence",
    "Text",
    "Type",
    "define",
    "fields_of",
    "full_name",
    "is_defined",
    "load",
]

WIDTHS = {
    "bool": ("?", 1),
    "octet": ("B", 1),
    "int8": ("b", 1),
    "uint8": ("B", 1),
    "int16": ("h", 2),
    "uint16": ("H", 2),
    "int32": ("i", 4),
    "uint32": ("I", 4),
    "int64": ("q", 8),
    "uint64": ("Q", 8),
    "float32": ("f", 4),
    "float64": ("d", 8),
}
"""Each primitive's letter in `struct`, and its size, which is its alignment too."""

_SPELLINGS = {"boolean": "bool", "float": "float32", "double": "float64", "char": "uint8"}


_defined: dict[str, Any] = {}


class MissingType(Exception):
    """A message, service or action type that this Python does not have."""

    def __init__(self, name: str, why: str) -> None:
        package = name.partition("/")[0]
        super().__init__(f"the type {name} is not installed: {why}")
        self.remedy = (
            f"Install it (`pip install ros-{package.replace('_', '-')}`), or source the workspace "
            "that contains it before starting the gateway."
        )


class Primitive(NamedTuple):
    """A bool, number or octet, by its name in `WIDTHS`."""

    name: str


class Text(NamedTuple):
    """A string, narrow or wide."""

    limit: int | None
    wide: bool


class Sequence(NamedTuple):
    """Many of one type."""

    item: Type
    size: int | None
    """Exactly so many, without a length on the wire."""
    limit: int | None
    """At most so many."""


class Ref(NamedTuple):
    """Another message."""

    cls: Any


Type = Primitive | Text | Sequence | Ref


class Field(NamedTuple):
    """A field of a message."""

    name: str
    type: Type


def load(name: str, group: str = "msg") -> Any:
    """Import the class of `pkg/msg/Name` (or `pkg/Name`).

    :raises MissingType: there is no such package, or no such type in it.
    """
    package, *middle, leaf = name.split("/")
    where = middle[0] if middle else group
    known = _defined.get(f"{package}/{where}/{leaf}")
    try:
        found: Any = getattr(importlib.import_module(f"{package}.{where}"), leaf)
    except (ImportError, AttributeError) as error:
        if known is not None:
            known.prepare()
            return known
        is_there = isinstance(error, AttributeError)
        why = f"{package} has no such {where}" if is_there else str(error)
        raise MissingType(name, why) from error
    return found


def define(cls: Any) -> None:
    """Have a class stand for its type wherever that is not installed.

    It says what `fields_of` should, itself, in a method `described`, and is made usable by
    `prepare`, which raises `MissingType` where that cannot be.
    """
    _defined[full_name(cls)] = cls


def is_defined(cls: Any) -> bool:
    """Tell whether a class was given to `define`, and so has no code of ROS's."""
    return _defined.get(full_name(cls)) is cls


def full_name(cls: Any) -> str:
    """Return `pkg/msg/Name` of a generated class."""
    package, where, *_ = cls.__module__.split(".")
    return f"{package}/{where}/{cls.__name__}"


@lru_cache(maxsize=4096)
def fields_of(cls: Any) -> tuple[Field, ...]:
    """Describe the fields of a message class, in their order on the wire."""
    if is_defined(cls):
        return cls.described()
    names = cls.get_fields_and_field_types()
    return tuple(
        Field(name, _translate(slot)) for name, slot in zip(names, cls.SLOT_TYPES, strict=True)
    )


def _translate(slot: Any) -> Type:
    kind = type(slot).__name__
    match kind:
        case "BasicType":
            spelled = str(slot.typename)
            return Primitive(_SPELLINGS.get(spelled, spelled))
        case "UnboundedString" | "UnboundedWString":
            return Text(None, "W" in kind)
        case "BoundedString" | "BoundedWString":
            return Text(slot.maximum_size, "W" in kind)
        case "Array":
            return Sequence(_translate(slot.value_type), slot.size, None)
        case "BoundedSequence":
            return Sequence(_translate(slot.value_type), None, slot.maximum_size)
        case "UnboundedSequence":
            return Sequence(_translate(slot.value_type), None, None)
        case "NamespacedType":
            return Ref(load("/".join((*slot.namespaces, slot.name))))
        case _:
            raise MissingType(kind, "unsupported field type")
