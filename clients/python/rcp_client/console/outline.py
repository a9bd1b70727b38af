"""A readable outline of a schema: one line per field."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rcp_client.console.output import compact

__all__ = ["outline"]

_DEEP = 6
_BOUNDS = (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
Row = tuple[str, str, str]


def outline(schema: dict[str, Any]) -> list[Row]:
    """List name, type and description of every field, nested ones by their dotted names."""
    return list(_rows("", schema, schema.get("$defs", {}), ""))


def _rows(name: str, node: dict[str, Any], defs: dict[str, Any], more: str) -> Iterator[Row]:
    target, optional = _follow(node, defs)
    text = _type(target, defs) + (" or null" if optional else "")
    facts = [fact for fact in (text, _bounds(target), _unit(node, target), more) if fact]
    note = node.get("description") or ("" if name else target.get("description", ""))
    if name or "properties" not in target:
        yield name or "value", ", ".join(facts), note
    if target.get("type") == "array":
        target, _ = _follow(target.get("items", {}), defs)
        name += "[]"
    if name.count(".") >= _DEEP:
        return
    required = target.get("required", ())
    for part, child in target.get("properties", {}).items():
        more = "required" if part in required else _default(child)
        yield from _rows(f"{name}.{part}" if name else part, child, defs, more)


def _follow(node: dict[str, Any], defs: dict[str, Any]) -> tuple[dict[str, Any], bool]:
    """Resolve a node, and return whether it may also be null."""
    optional = False
    for _ in range(_DEEP):
        if (reference := node.get("$ref")) is not None:
            node = defs.get(reference.rpartition("/")[2], {})
        elif options := node.get("anyOf"):
            real = [option for option in options if option.get("type") != "null"]
            optional = optional or len(real) < len(options)
            node = {**real[0], **{k: v for k, v in node.items() if k == "unit"}} if real else {}
        else:
            break
    return node, optional


def _type(node: dict[str, Any], defs: dict[str, Any]) -> str:
    if "enum" in node:
        return "one of " + " ".join(map(str, node["enum"]))
    if node.get("contentEncoding") == "base64":
        return "bytes"
    kind = node.get("type", "anything")
    if kind == "array":
        item, _ = _follow(node.get("items", {}), defs)
        unit = item.get("unit", "")
        return f"list of {_type(item, defs)}" + (f" in {unit}" if unit not in ("", "1") else "")
    return "group" if "properties" in node else "map" if kind == "object" else str(kind)


def _bounds(node: dict[str, Any]) -> str:
    return " ".join(f"{sign} {compact(node[key])}" for key, sign in _BOUNDS if key in node)


def _unit(node: dict[str, Any], target: dict[str, Any]) -> str:
    unit = node.get("unit") or target.get("unit") or ""
    return "" if unit == "1" else unit


def _default(node: dict[str, Any]) -> str:
    default = node.get("default")
    return "" if default is None or isinstance(default, dict) else f"default {compact(default)}"
