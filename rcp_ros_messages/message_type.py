"""Message types, read from their definitions."""

from __future__ import annotations

import re
from collections.abc import Mapping
from copy import deepcopy
from functools import lru_cache
from typing import Any, NamedTuple

from rcp_ros_messages.definitions import DEFINITIONS

__all__ = [
    "PRIMITIVES",
    "Constant",
    "Field",
    "MessageType",
    "full_name",
    "message_text",
    "message_type",
    "parse",
    "parse_all",
    "short_name",
    "zero",
]

PRIMITIVES: dict[str, Any] = {
    "bool": False,
    "byte": 0,
    "char": 0,
    "float32": 0.0,
    "float64": 0.0,
    "int8": 0,
    "uint8": 0,
    "int16": 0,
    "uint16": 0,
    "int32": 0,
    "uint32": 0,
    "int64": 0,
    "uint64": 0,
    "string": "",
}
"""The primitive types, with the value of a field that nobody has set."""
_LINE = re.compile(
    r"^(?P<type>[\w/]+)(?:<=\d+)?(?:\[(?P<length>\d*|<=\d+)\])?\s+(?P<name>\w+)"
    r"(?:\s*=\s*(?P<value>.*)|\s.*)?$"
)
"""A field, maybe with a default, or a constant; a bound counts as none."""
_RULE = "=" * 80


class Field(NamedTuple):
    """A field: `length` is None for a single value, 0 for a sequence, else that of an array."""

    name: str
    type: str
    length: int | None

    @property
    def text(self) -> str:
        """The field as a line of a definition."""
        array = "" if self.length is None else f"[{self.length or ''}]"
        return f"{short_name(self.type)}{array} {self.name}"


class Constant(NamedTuple):
    """A constant of a message."""

    name: str
    type: str
    value: str


class MessageType(NamedTuple):
    """A message type; the types of its fields are primitive, or full names."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...] = ()


def full_name(name: str) -> str:
    """Return `package/msg/Type` for that or for `package/Type`."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


def short_name(name: str) -> str:
    """Return `package/Type` for a full name."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[2]}" if len(parts) == 3 else name


def parse(name: str, text: str) -> MessageType:
    """Read a definition."""
    fields: list[Field] = []
    constants: list[Constant] = []
    for line in filter(None, map(_without_comment, text.split("\n"))):
        found = _LINE.match(line)
        if found is None:
            raise ValueError(f"{name}: cannot read {line!r}")
        type_ = found["type"]
        if type_ not in PRIMITIVES:
            type_ = full_name(
                type_ if "/" in type_ else f"{name.split('/', maxsplit=1)[0]}/{type_}"
            )
        if found["value"] is not None:
            constants.append(Constant(found["name"], type_, found["value"]))
        else:
            length = None if found["length"] is None else _length(found["length"])
            fields.append(Field(found["name"], type_, length))
    return MessageType(name, tuple(fields), tuple(constants))


def _without_comment(line: str) -> str:
    return line.partition("#")[0].strip()


def _length(text: str) -> int:
    return int(text) if text.isdecimal() else 0


@lru_cache(maxsize=256)
def parse_all(name: str, text: str) -> Mapping[str, MessageType]:
    """Read a definition with those of the types that it contains, by full name; the first is its own.

    :raises ValueError: it cannot be read.
    """
    first, *others = re.split(r"^={40,}$", text, flags=re.MULTILINE)
    found = {full_name(name): parse(full_name(name), first)}
    for other in others:
        head, _, rest = other.strip().partition("\n")
        inner = full_name(head.removeprefix("MSG:").strip())
        found[inner] = parse(inner, rest)
    return found


@lru_cache(maxsize=256)
def message_type(name: str) -> MessageType | None:
    """Return a common type by its full or short name; None if it is not one of them."""
    full = full_name(name)
    text = DEFINITIONS.get(full)
    return None if text is None else parse(full, text)


@lru_cache(maxsize=256)
def message_text(name: str) -> str | None:
    """Return the definition with those of the types that it contains, as `ros2msg` schemas have it."""
    first = message_type(name)
    if first is None:
        return None
    found: dict[str, MessageType] = {}
    _collect(first, found)
    texts = [_text(first)]
    texts += [f"{_RULE}\nMSG: {short_name(n)}\n{_text(t)}" for n, t in found.items()]
    return "\n".join(texts)


def _collect(type_: MessageType, found: dict[str, MessageType]) -> None:
    for field in type_.fields:
        inner = message_type(field.type)
        if inner is not None and inner.name not in found:
            found[inner.name] = inner
            _collect(inner, found)


def _text(type_: MessageType) -> str:
    lines = [f"{c.type} {c.name}={c.value}" for c in type_.constants]
    return "\n".join([*lines, *(field.text for field in type_.fields)])


def zero(name: str) -> dict[str, Any]:
    """Return a message whose fields nobody has set."""
    return deepcopy(_zero(full_name(name)))


@lru_cache(maxsize=256)
def _zero(name: str) -> dict[str, Any]:
    type_ = message_type(name)
    if type_ is None:
        raise KeyError(name)
    return {field.name: _zero_field(field) for field in type_.fields}


def _zero_field(field: Field) -> Any:
    if field.length == 0:
        return b"" if field.type in ("uint8", "byte", "char") else []
    one = PRIMITIVES[field.type] if field.type in PRIMITIVES else zero(field.type)
    return one if field.length is None else [one] * field.length
