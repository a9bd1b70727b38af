"""Message types created at run time from their `.msg` text or a node's type description.

Objects of such types have no serialization code: `writer.py` encodes published values, and
`support.py` provides the type support that rclpy requires.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from rcp_ros2.comments import remember
from rcp_ros2.idl import WIDTHS, Field, MissingType, Primitive, Ref, Sequence, Text, Type, load
from rcp_ros2.idl import define as define_class
from rcp_ros2.support import IDS, forge

__all__ = [
    "SPEED_LIMIT",
    "TF_MESSAGE",
    "BadText",
    "define_described",
    "define_text",
    "is_made",
    "parse",
]

SPEED_LIMIT = "nav2_msgs/msg/SpeedLimit"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
_LINE = re.compile(
    r"(?P<base>[A-Za-z]\w*(?:/\w+){0,2})(?:<=(?P<limit>\d+))?"
    r"(?:\[(?P<upto><=)?(?P<size>\d*)\](?P<array>))?\s+(?P<name>[A-Za-z]\w*)(?P<rest>.*)\Z"
)
_WORD = re.compile(r"(?:[A-Za-z]\w*/msg/)?[A-Za-z]\w*\Z")
_NEXT = re.compile(r"^={10,}\s*\n\s*MSG:\s*(\S+)\s*\n", re.MULTILINE)
_OLD = {"byte": "octet", "char": "uint8", "Header": "std_msgs/msg/Header"}
_NAMES = {id_: name for name, id_ in IDS.items()}
_STRINGS = {17: (False, False), 18: (True, False), 21: (False, True), 22: (True, True)}
"""Types of type_description_interfaces/msg/FieldType; flags: wide string, bounded string."""
_DUMMY = "structure_needs_at_least_one_member"


class BadText(ValueError):
    """The text is not a valid message definition."""


class Part(NamedTuple):
    """A field whose type may not be loaded yet."""

    name: str
    base: str
    """A primitive, or the full name of another message."""
    shape: Callable[[Type], Type]
    """Builds the field's type from the base type."""


def is_made(cls: Any) -> bool:
    """Return whether a class was created at run time."""
    return isinstance(cls, _Made)


def parse(name: str, text: str) -> dict[str, list[Part]]:
    """Parse the text of a message with the texts it refers to, as `gendeps` writes them.

    :raises BadText: a line is not valid in a `.msg` file.
    """
    return {key: _parsed(key, body) for key, body in _texts(name, text).items()}


def _texts(name: str, text: str) -> dict[str, str]:
    first, *rest = _NEXT.split(text)
    return {name: first} | dict(zip(map(_full, rest[::2]), rest[1::2], strict=True))


def define_text(name: str, text: str) -> None:
    """Define the type `pkg/msg/Name`; an installed type takes precedence.

    :raises BadText: as for `parse`.
    """
    for key, body in _texts(name, text).items():
        _define(key, _parsed(key, body))
        remember(key, body)


def define_described(description: Any, sources: Iterable[Any] = ()) -> None:
    """Define the types of a type_description_interfaces/msg/TypeDescription, with their texts.

    :raises MissingType: a field has an unsupported type.
    """
    for one in (description.type_description, *description.referenced_type_descriptions):
        parts = [_described(f) for f in one.fields if f.name != _DUMMY]
        _define(one.type_name, parts)
    for source in sources:
        remember(source.type_name, source.raw_file_contents)


def _define(name: str, parts: list[Part]) -> None:
    bad = next((word for word in (name, *(p.name for p in parts)) if not _WORD.match(word)), None)
    if bad is not None:  # nodes are not trusted
        raise MissingType(name, f"{bad[:80]!r} is not a valid name")
    package, _, leaf = name.split("/")
    kind = type(f"Metaclass_{leaf}", (_Made,), {})  # a metaclass per type holds its support
    define_class(kind(leaf, (), {"__module__": f"{package}.msg", "parts": parts}))


class _Made(type):
    """The metaclass of classes created at run time, where rclpy looks for the type support."""

    parts: list[Part]
    _TYPE_SUPPORT: Any = None
    _CREATE_ROS_MESSAGE = _CONVERT_FROM_PY = _CONVERT_TO_PY = _DESTROY_ROS_MESSAGE = ""

    def prepare(cls) -> None:
        """Create the type support that rclpy requires, once."""
        if cls._TYPE_SUPPORT is None:
            type(cls)._TYPE_SUPPORT = forge(cls, cls.described())  # noqa: SLF001 - its own

    def described(cls) -> tuple[Field, ...]:
        """Return the fields; the types they refer to are loaded on demand."""
        return tuple(Field(name, shape(_base(base))) for name, base, shape in cls.parts)


def _base(text: str) -> Type:
    return Primitive(text) if text in WIDTHS else Ref(load(text))


def _full(name: str) -> str:
    package, _, leaf = name.partition("/")
    return name if "/" in leaf else f"{package}/msg/{leaf}"


def _parsed(name: str, text: str) -> list[Part]:
    lines = (line.partition("#")[0].strip() for line in text.splitlines())
    found = [_part(name, line) for line in lines if line]
    return [part for part in found if part is not None]


def _part(type_name: str, line: str) -> Part | None:
    """Parse the field on a line; None for a constant."""
    found = _LINE.match(line)
    if found is None:
        raise BadText(f"{line!r} in the text of {type_name} is not valid in a .msg file")
    if found["rest"].strip().startswith("="):
        return None
    size = int(found["size"]) if found["size"] else None
    kind = "one" if found["array"] is None else "upto" if found["upto"] else "many"
    base = _OLD.get(found["base"], found["base"])
    if base in ("string", "wstring"):
        text = Text(int(found["limit"]) if found["limit"] else None, base == "wstring")
        return Part(found["name"], "bool", _shape(kind, size, text))
    if base not in WIDTHS:
        package = type_name.partition("/")[0]
        base = _full(base) if "/" in base else f"{package}/msg/{base}"
    return Part(found["name"], base, _shape(kind, size))


def _shape(kind: str, size: int | None, text: Text | None = None) -> Callable[[Type], Type]:
    def shape(base: Type) -> Type:
        item = base if text is None else text
        match kind:
            case "one":
                return item
            case "upto":
                return Sequence(item, None, size)
            case _:
                return Sequence(item, size, None)

    return shape


def _described(field: Any) -> Part:
    type_ = field.type
    more, id_ = divmod(type_.type_id - 1, 48)
    id_ += 1
    kind = ("one", "many", "upto", "many")[more]
    size = type_.capacity if more in (1, 2) else None
    if id_ == 1:
        return Part(field.name, type_.nested_type_name, _shape(kind, size))
    if id_ in _NAMES:
        return Part(field.name, _NAMES[id_], _shape(kind, size))
    if id_ in _STRINGS:
        wide, bounded = _STRINGS[id_]
        text = Text(type_.string_capacity if bounded else None, wide)
        return Part(field.name, "bool", _shape(kind, size, text))
    raise MissingType(field.name, f"unsupported field type {type_.type_id}")


define_text(TF_MESSAGE, "geometry_msgs/TransformStamped[] transforms")
define_text(SPEED_LIMIT, "std_msgs/Header header\nbool percentage\nfloat64 speed_limit")
