"""The fields of message classes, described by five types.

rosidl's generated classes describe themselves (`SLOT_TYPES`). Types, decoder and filler are all
derived from this one description, so that they agree.
"""

from __future__ import annotations

import contextlib
import importlib
import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
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
    "is_known",
    "load",
    "looking_in",
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
"""The `struct` format character of each primitive, and its size and alignment."""

_SPELLINGS = {"boolean": "bool", "float": "float32", "double": "float64", "char": "uint8"}


_NAME = re.compile(r"[a-z][a-z0-9_]*(/(msg|srv|action))?/[A-Z][A-Za-z0-9_]*")
"""A package, the kind of interface, a type, or a part of one (`SetBool_Request`)."""
_defined: dict[str, Any] = {}
_sources: list[Callable[[str], bool]] = []


class MissingType(Exception):
    """A message, service or action type that is not installed in this Python."""

    def __init__(self, name: str, why: str) -> None:
        package = name.partition("/")[0]
        super().__init__(f"the type {name} is not installed: {why}")
        self.remedy = (
            f"Install it (`pip install ros-{package.replace('_', '-')}`), source the workspace that "
            "contains it before starting the gateway, or give its text in `types` or its folder in "
            "`interfaces`."
        )


class Primitive(NamedTuple):
    """A bool, number or octet, by its name in `WIDTHS`."""

    name: str


class Text(NamedTuple):
    """A string, narrow or wide."""

    limit: int | None
    wide: bool


class Sequence(NamedTuple):
    """An array or sequence of one type."""

    item: Type
    size: int | None
    """Exact number of elements, without a length on the wire."""
    limit: int | None
    """Maximum number of elements."""


class Ref(NamedTuple):
    """A nested message."""

    cls: Any


Type = Primitive | Text | Sequence | Ref


class Field(NamedTuple):
    """A field of a message."""

    name: str
    type: Type


def _has_interfaces(package: str) -> bool:
    """Return whether a package was generated from interfaces, without importing it."""
    spec = find_spec(package)
    places = () if spec is None else spec.submodule_search_locations or ()
    return any(
        next(Path(place).glob(f"{package}_s__rosidl_typesupport_c*"), None) for place in places
    )


def load(name: str, group: str = "msg") -> Any:
    """Import the class of `pkg/msg/Name` (or `pkg/Name`).

    Names come from other nodes and from clients: nothing is imported that is no package of
    interfaces.

    :raises MissingType: there is no such package, or no such type in it.
    """
    if _NAME.fullmatch(name) is None:
        raise MissingType(name, "it is not the name of a type")
    package, *middle, leaf = name.split("/")
    where = middle[0] if middle else group
    full = f"{package}/{where}/{leaf}"
    try:
        if not _has_interfaces(package):
            raise ModuleNotFoundError(f"No module named '{package}' with interfaces of ROS 2")
        found: Any = getattr(importlib.import_module(f"{package}.{where}"), leaf)
    except (ImportError, AttributeError) as error:
        known = _defined.get(full)
        if known is None and any(source(full) for source in _sources):
            known = _defined.get(full)
        if known is not None:
            known.prepare()
            return known
        is_there = isinstance(error, AttributeError)
        why = f"{package} has no such {where}" if is_there else str(error)
        raise MissingType(name, why) from error
    return found


def define(cls: Any) -> None:
    """Register a class for a type; used if that is not installed.

    The class provides its fields by a method `described`, and is made usable by `prepare`, which
    raises
    `MissingType` if that is impossible.
    """
    _defined[full_name(cls)] = cls


@contextlib.contextmanager
def looking_in(source: Callable[[str], bool]) -> Iterator[None]:
    """Ask a source for types while entered: it defines one by its full name, and returns whether it could."""
    _sources.append(source)
    try:
        yield
    finally:
        _sources.remove(source)


def is_known(name: str) -> bool:
    """Return whether `define` was given a class of this name."""
    return name in _defined


def is_defined(cls: Any) -> bool:
    """Return whether a class was given to `define`, and so has no code generated by ROS."""
    return _defined.get(full_name(cls)) is cls


def full_name(cls: Any) -> str:
    """Return `pkg/msg/Name` of a generated class."""
    package, where, *_ = cls.__module__.split(".")
    return f"{package}/{where}/{cls.__name__}"


@lru_cache(maxsize=4096)
def fields_of(cls: Any) -> tuple[Field, ...]:
    """Return the fields of a message class, in wire order."""
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
