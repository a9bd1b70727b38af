"""Types created at run time from their text or a node's type description.

Objects of such types have no serialization code: `writer.py` encodes their values, and
`support.py` provides the type support that rclpy requires.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any

from rcp_ros2.comments import remember
from rcp_ros2.idl import WIDTHS, MissingType, Sequence, Text, Type
from rcp_ros2.made import Part, define_action, define_message, define_service
from rcp_ros2.support import IDS
from rcp_ros2.well_known import VERSIONS

__all__ = [
    "TF_MESSAGE",
    "BadText",
    "define_described",
    "define_text",
    "parse",
]

TF_MESSAGE = "tf2_msgs/msg/TFMessage"
_LINE = re.compile(
    r"(?P<base>[A-Za-z]\w*(?:/\w+){0,2})(?:<=(?P<limit>\d+))?"
    r"(?:\[(?P<upto><=)?(?P<size>\d*)\](?P<array>))?\s+(?P<name>[A-Za-z]\w*)(?P<rest>.*)\Z"
)
_RULE = re.compile(r"^---.*$", re.MULTILINE)
_ENDINGS = {
    "msg": ("",),
    "srv": ("_Request", "_Response"),
    "action": ("_Goal", "_Result", "_Feedback"),
}
"""The messages whose texts follow each other in one text."""
_NEXT = re.compile(r"^={10,}\s*\n\s*MSG:\s*(\S+)\s*\n", re.MULTILINE)
_OLD = {"byte": "octet", "char": "uint8", "Header": "std_msgs/msg/Header"}
_NAMES = {id_: name for name, id_ in IDS.items()}
_STRINGS = {17: (False, False), 18: (True, False), 21: (False, True), 22: (True, True)}
"""Types of type_description_interfaces/msg/FieldType; flags: wide string, bounded string."""
_DUMMY = "structure_needs_at_least_one_member"


class BadText(ValueError):
    """The text is not a valid message definition."""


def parse(name: str, text: str) -> dict[str, list[Part]]:
    """Parse the text of a message, service or action with the texts it refers to, as `gendeps` writes them.

    :raises BadText: a line is not valid in a `.msg` file.
    """
    found: dict[str, list[Part]] = {}
    for key, body in _texts(name, text).items():
        endings = _ENDINGS[key.split("/")[1]]
        bodies = _RULE.split(body)
        if len(bodies) != len(endings):
            raise BadText(
                f"the text of {key} has {len(bodies)} parts, of {len(endings)}, between lines of ---"
            )
        for ending, part in zip(endings, bodies, strict=True):
            found[f"{key}{ending}"] = _parsed(key, part)
    return found


def _texts(name: str, text: str) -> dict[str, str]:
    first, *rest = _NEXT.split(text)
    return {name: first} | dict(zip(map(_full, rest[::2]), rest[1::2], strict=True))


def define_text(name: str, text: str) -> None:
    """Define the message, service or action `pkg/msg/Name`; an installed type takes precedence.

    :raises BadText: as for `parse`.
    """
    for key, parts in parse(name, text).items():
        define_message(key, parts)
    for key, body in _texts(name, text).items():
        remember(key, body)
    match name.split("/")[1]:
        case "srv":
            define_service(name)
        case "action":
            define_action(name)
        case _:
            pass


def define_described(description: Any, sources: Iterable[Any] = ()) -> None:
    """Define the types of a type_description_interfaces/msg/TypeDescription, with their texts.

    :raises MissingType: a field has an unsupported type.
    """
    for one in (description.type_description, *description.referenced_type_descriptions):
        parts = [_described(f) for f in one.fields if f.name != _DUMMY]
        define_message(one.type_name, parts)
    for source in sources:
        remember(source.type_name, source.raw_file_contents)


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


for _name, _versions in VERSIONS.items():
    if "/msg/" in _name:
        define_text(_name, _versions[0])
