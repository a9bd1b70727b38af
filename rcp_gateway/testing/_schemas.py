"""Valid and invalid example values of a published JSON Schema."""

from __future__ import annotations

import base64
import math
from typing import Any

from rcp_protocol.plain import is_list, is_map

__all__ = ["beyond", "legal", "numbers_without_unit", "same"]

Schema = dict[str, Any]
_FEW = 4  # values made of one schema
_FAR = 1000.0  # from zero, where a schema names no bound


def _resolved(node: Schema, root: Schema) -> Schema:
    while "$ref" in node:
        node = {**root["$defs"][node["$ref"].rpartition("/")[2]], **_without_ref(node)}
    return node


def _without_ref(node: Schema) -> Schema:
    return {key: item for key, item in node.items() if key != "$ref"}


def numbers_without_unit(schema: Schema) -> list[str]:
    """List the places in a schema where a number says no unit (`"1"` is that of a count)."""
    return _unitless(schema, schema, "", set())


def _unitless(node: Any, root: Schema, where: str, seen: set[str]) -> list[str]:
    if not is_map(node):
        return []
    ref = node.get("$ref")
    if ref is not None:
        if ref in seen:
            return []
        seen = seen | {ref}
    node = _resolved(node, root)
    if node.get("type") in ("number", "integer") and "unit" not in node:
        return [where or "the value"]
    unit = {"unit": node["unit"]} if "unit" in node else {}
    found: list[str] = []
    for option in node.get("anyOf", ()):
        found += _unitless({**unit, **option}, root, where, seen)
    for name, child in node.get("properties", {}).items():
        found += _unitless(child, root, f"{where}/{name}", seen)
    for place, child in enumerate(node.get("prefixItems", ())):
        found += _unitless(child, root, f"{where}/{place}", seen)
    for key in ("items", "additionalProperties"):
        found += _unitless(node.get(key), root, f"{where}/*", seen)
    return found


def legal(schema: Schema) -> list[Any]:
    """Return a few valid values of a schema, different ones where possible."""
    return _legal(schema, schema, 0)


def _legal(node: Schema, root: Schema, deep: int) -> list[Any]:
    node = _resolved(node, root)
    if "const" in node:
        return [node["const"]]
    if "enum" in node:
        return node["enum"][:_FEW]
    if "anyOf" in node:
        options = [_legal(option, root, deep + 1) for option in node["anyOf"]]
        return [value for several in options for value in several if value is not None] or [None]
    match node.get("type"):
        case "number":
            return _span(node)
        case "integer":
            low, high = _span(node)
            return sorted({round(low), round(high)})
        case "boolean":
            return [False, True]
        case "string":
            return _texts(node)
        case "array":
            return _arrays(node, root, deep)
        case "object":
            return _objects(node, root, deep)
        case _:
            return [None]


def _span(node: Schema) -> list[float]:
    low = node.get("minimum", node.get("exclusiveMinimum", -_FAR))
    high = node.get("maximum", node.get("exclusiveMaximum", max(_FAR, low + _FAR)))
    low = max(low, min(high - _FAR, 0.0)) if low < -_FAR else low
    step = (high - low) / 4
    return [low + step, low + 2 * step] if node["type"] == "number" else [low + 1, high - 1]


def _texts(node: Schema) -> list[Any]:
    if node.get("contentEncoding") == "base64":
        least = math.ceil(node.get("minLength", 0) * 3 / 4)
        return [_encoded(bytes(least)), _encoded(bytes(range(max(3, min(least, 255)))))]
    if "pattern" in node:
        return list(node.get("examples", ()))
    return ["a" * node.get("minLength", 0), "b" * min(max(node.get("minLength", 1), 1), 8)]


def _arrays(node: Schema, root: Schema, deep: int) -> list[Any]:
    if "prefixItems" in node:
        return [[(_legal(child, root, deep + 1) or [None])[0] for child in node["prefixItems"]]]
    items = _legal(node.get("items") or {}, root, deep + 1) if deep < _FEW else []
    least = node.get("minItems", 0)
    return [(items[:1] or [None]) * least, (items[-1:] or [None]) * least]


def _objects(node: Schema, root: Schema, deep: int) -> list[Any]:
    properties: Schema = node.get("properties", {})
    required = node.get("required", ())
    base = {name: (_legal(properties[name], root, deep + 1) or [None])[0] for name in required}
    found = [base]
    for name, child in properties.items() if deep < _FEW else ():
        found += [{**base, name: value} for value in _legal(child, root, deep + 1)[-1:]]
    return found[: 2 * _FEW]


def beyond(schema: Schema) -> list[Any]:
    """Return values that violate exactly one bound of a schema."""
    return _beyond(schema, schema, 0)


def _beyond(node: Schema, root: Schema, deep: int) -> list[Any]:
    node = _resolved(node, root)
    if deep > _FEW:
        return []
    if "anyOf" in node:
        return [value for option in node["anyOf"] for value in _beyond(option, root, deep + 1)]
    if node.get("type") in ("number", "integer"):
        return _outside(node)
    if node.get("type") == "object":
        base = (_objects(node, root, deep) or [{}])[0]
        return [
            {**base, name: value}
            for name, child in node.get("properties", {}).items()
            for value in _beyond(child, root, deep + 1)
        ]
    items: Any = node.get("items")
    if node.get("type") == "array" and is_map(items):
        least = max(1, node.get("minItems", 1))
        return [[value] * least for value in _beyond(items, root, deep + 1)]
    return []


def _outside(node: Schema) -> list[Any]:
    found: list[Any] = []
    for key, sign in (("minimum", -1), ("maximum", 1)):
        if key in node and abs(node[key]) < 2**53:
            found.append(node[key] + sign)
    return found + [node[key] for key in ("exclusiveMinimum", "exclusiveMaximum") if key in node]


def same(first: Any, second: Any, tolerance: float = 1e-6) -> bool:
    """Compare plain values, numbers to within a tolerance, relative above 1 and absolute below."""
    if is_map(first) and is_map(second):
        keys = first.keys() | second.keys()
        return all(same(first.get(key), second.get(key), tolerance) for key in keys)
    if is_list(first) and is_list(second):
        pairs = zip(first, second, strict=False)
        return len(first) == len(second) and all(same(a, b, tolerance) for a, b in pairs)
    if isinstance(first, (int, float)) and isinstance(second, (int, float)):
        return abs(first - second) <= tolerance * max(1.0, abs(first), abs(second))
    return _told(first) == _told(second)


def _told(value: Any) -> Any:
    """Return bytes as they are told in JSON."""
    return _encoded(value) if isinstance(value, bytes) else value


def _encoded(data: bytes) -> str:
    return base64.b64encode(data).decode()
