"""Descriptions of message types, as the rosapi services give them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcp_ros_messages import MessageType, full_name, message_text, message_type, parse_all

__all__ = ["Typedef", "text_of", "typedefs", "typedefs_of_schema", "typedefs_of_text"]

Typedef = dict[str, Any]
_PRIMITIVES = {"number": "float64", "integer": "int64", "boolean": "boolean", "string": "string"}
_DEPTH = 8


def typedefs(name: str) -> list[Typedef]:
    """Describe a common type and those that it contains; empty if it is not one of them."""
    first = message_type(name)
    found: dict[str, Typedef] = {}
    if first is not None:
        _collect(first, found, message_type)
    return list(found.values())


def typedefs_of_text(name: str, text: str) -> list[Typedef]:
    """Describe a type by its definition with those of the types that it contains.

    :raises ValueError: it cannot be read.
    """
    known = parse_all(name, text)
    found: dict[str, Typedef] = {}
    _collect(known[full_name(name)], found, lambda inner: known.get(inner) or message_type(inner))
    return list(found.values())


def _collect(
    type_: MessageType, found: dict[str, Typedef], find: Callable[[str], MessageType | None]
) -> None:
    if type_.name in found:
        return
    found[type_.name] = {
        "type": type_.name,
        "fieldnames": [field.name for field in type_.fields],
        "fieldtypes": [field.type for field in type_.fields],
        "fieldarraylen": [-1 if f.length is None else f.length for f in type_.fields],
        "examples": [_example(field.type, field.length) for field in type_.fields],
        "constnames": [constant.name for constant in type_.constants],
        "constvalues": [constant.value for constant in type_.constants],
    }
    for field in type_.fields:
        inner = find(field.type)
        if inner is not None:
            _collect(inner, found, find)


def _example(type_: str, length: int | None) -> str:
    if length is not None:
        return "[]"
    if type_ == "string":
        return ""
    if type_ == "bool":
        return "False"
    return "{}" if "/" in type_ else "0.0" if type_.startswith("float") else "0"


def typedefs_of_schema(name: str, schema: dict[str, Any]) -> list[Typedef]:
    """Describe a type by the JSON Schema of its values."""
    found: dict[str, Typedef] = {}
    _from_schema(name, schema, schema, found, _DEPTH)
    return list(found.values())


def _from_schema(
    name: str,
    schema: dict[str, Any],
    whole: dict[str, Any],
    found: dict[str, Typedef],
    depth: int,
) -> None:
    if name in found or not depth:
        return
    resolved = _resolved(schema, whole)
    properties: dict[str, Any] = resolved.get("properties") or {"data": resolved}
    types: list[str] = []
    lengths: list[int] = []
    found[name] = {
        "type": name,
        "fieldnames": list(properties),
        "fieldtypes": types,
        "fieldarraylen": lengths,
        "examples": ["" for _ in properties],
        "constnames": [],
        "constvalues": [],
    }
    for field, inner in properties.items():
        item, length = _resolved(inner, whole), -1
        if "contentEncoding" in item:
            types.append("uint8")
            lengths.append(0)
            continue
        if item.get("type") == "array":
            bound = item.get("maxItems") or 0
            length = bound if bound == item.get("minItems") else 0
            inner = item.get("items") or {}  # noqa: PLW2901 - described instead of its list
            item = _resolved(inner, whole)
        lengths.append(length)
        plain = _PRIMITIVES.get(str(item.get("type")))
        if plain is None:
            plain = _name_of(inner, name, field)
            _from_schema(plain, item, whole, found, depth - 1)
        types.append(plain)


def _name_of(schema: dict[str, Any], holder: str, field: str) -> str:
    package = holder.split("/", maxsplit=1)[0]
    ref = schema.get("$ref")
    last = ref.rpartition("/")[2] if isinstance(ref, str) else field.title().replace("_", "")
    return f"{package}/msg/{last.rpartition('.')[2]}"


def _resolved(schema: dict[str, Any], whole: dict[str, Any]) -> dict[str, Any]:
    ref = schema.get("$ref")
    if isinstance(ref, str):
        return whole.get("$defs", {}).get(ref.rpartition("/")[2]) or {}
    for option in schema.get("anyOf") or ():
        if option.get("type") != "null":  # a field that may be unknown
            return _resolved(option, whole)
    return schema


def text_of(name: str, schema: dict[str, Any]) -> str:
    """Return the definition of a type with those that it contains."""
    text = message_text(name)
    if text is not None:
        return text
    parts: list[str] = []
    for one in typedefs_of_schema(full_name(name), schema):
        head = "" if not parts else "=" * 80 + f"\nMSG: {one['type'].replace('/msg/', '/')}\n"
        lines = [
            f"{'bool' if type_ == 'boolean' else type_.replace('/msg/', '/')}"
            f"{'' if length < 0 else f'[{length or str()}]'} {field}"
            for field, type_, length in zip(
                one["fieldnames"], one["fieldtypes"], one["fieldarraylen"], strict=True
            )
        ]
        parts.append(head + "\n".join(lines))
    return "\n".join(parts)
