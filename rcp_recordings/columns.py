"""Fields of values as columns of a table: by the schema, so that all rows have the same."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import msgspec

__all__ = ["Column", "cell", "columns", "numbers", "part"]

_DEPTH = 6  # fields of fields
Kind = Literal["number", "integer", "boolean", "string", "json"]


class Column(NamedTuple):
    """One field."""

    name: str
    """`position.x`; empty for a value that is no object."""
    kind: Kind


def columns(schema: dict[str, Any], wanted: tuple[str, ...] = ()) -> list[Column]:
    """List the fields of a schema; `wanted` keeps only these, or what is below them."""
    found = list(_fields(schema, schema.get("$defs", {}), "", 0))
    if not wanted:
        return found
    return [
        column
        for column in found
        if any(column.name == one or column.name.startswith(f"{one}.") for one in wanted)
    ]


def _fields(
    schema: dict[str, Any], defs: dict[str, Any], name: str, depth: int
) -> Iterator[Column]:
    schema = _resolved(schema, defs)
    kind = schema.get("type")
    if isinstance(kind, list):
        some = [one for one in kind if one not in ("null", "string")] or ["string"]
        kind = some[0] if len(some) == 1 else None
    properties = schema.get("properties")
    if properties and depth < _DEPTH:
        for key, inner in properties.items():
            yield from _fields(inner, defs, f"{name}.{key}" if name else key, depth + 1)
    elif kind in ("number", "integer", "boolean", "string"):
        yield Column(name, kind)
    else:
        yield Column(name, "json")


def _resolved(schema: dict[str, Any], defs: dict[str, Any]) -> dict[str, Any]:
    """Follow references, and what may be null or the name of a number that JSON does not have."""
    while True:
        if (named := schema.get("$ref")) is not None:
            schema = defs.get(named.rpartition("/")[2], {})
            continue
        choices = schema.get("anyOf") or schema.get("oneOf")
        if not choices:
            return schema
        some = [one for one in choices if one.get("type") != "null" and "enum" not in one]
        if len(some) != 1:
            return {}
        (schema,) = some


def part(value: Any, name: str) -> Any:
    """Return a field of a value by its name; None if there is none."""
    for key in name.split(".") if name else ():
        if not isinstance(value, dict):
            return None
        value = value.get(key)  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    return value  # pyright: ignore[reportUnknownVariableType]


def numbers(value: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Iterate over the finite numbers in a value, with the names of their fields."""
    if isinstance(value, bool):
        return
    if isinstance(value, (int, float)):
        yield name, value
    elif isinstance(value, dict):
        for key, inner in value.items():  # pyright: ignore[reportUnknownVariableType]
            yield from numbers(inner, f"{name}.{key}" if name else str(key))  # pyright: ignore[reportUnknownArgumentType]


def cell(value: Any, kind: Kind) -> Any:
    """Return a field as a column of its kind has it; None for what is missing or does not fit."""
    if value is None:
        return None
    match kind:
        case "number":
            return float(value) if isinstance(value, (int, float, str)) else None
        case "integer":
            return int(value) if isinstance(value, (int, str)) else None
        case "boolean":
            return value if isinstance(value, bool) else None
        case "string":
            return str(value)
        case "json":
            return msgspec.json.encode(value).decode()
