"""A JSON Schema narrowed by bounds: the values a principal may send, for forms and models."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rcp_conditions.fields import Field
from rcp_motion_limits.config import Bound
from rcp_motion_limits.limit import within
from rcp_protocol.plain import is_list, is_map

__all__ = ["narrowed"]

Schema = dict[str, Any]
_KEPT = ("title", "description", "unit", "default")


def narrowed(schema: Schema, bounds: Iterable[tuple[str, Bound]]) -> Schema:
    """Return a schema narrowed by bounds, given by field; the result has no `$id`."""
    root = {key: item for key, item in schema.items() if key != "$id"}
    for field, bound in bounds:
        steps = tuple(field.split(".")) if field else ()
        root = _narrow(root, steps, bound, schema.get("$defs", {})) or {"not": {}}
    return root


def _narrow(node: Any, steps: tuple[str, ...], bound: Bound, defs: Schema) -> Schema | None:
    """Narrow the schema of a field; None if no value is left."""
    node = _resolved(node, defs)
    if "anyOf" in node:
        return _narrow_options(node, steps, bound, defs)
    if node.get("type") == "null":
        return node if bound.optional else None
    if not steps:
        return _bounded(node, bound)
    if is_map(node.get("properties")) or node.get("type") == "object":
        return _narrow_object(node, steps, bound, defs)
    return _narrow_array(node, steps, bound, defs)


def _narrow_options(
    node: Schema, steps: tuple[str, ...], bound: Bound, defs: Schema
) -> Schema | None:
    rest = {key: item for key, item in node.items() if key != "anyOf"}
    options = [_narrow(option, steps, bound, defs) for option in node["anyOf"]]
    left = [option for option in options if option is not None]
    if not left:
        return None
    return {**left[0], **rest} if len(left) == 1 else {**rest, "anyOf": left}


def _narrow_object(
    node: Schema, steps: tuple[str, ...], bound: Bound, defs: Schema
) -> Schema | None:
    step, rest = steps[0], steps[1:]
    own: Schema = node.get("properties", {})
    other = node.get("additionalProperties")
    if step == "*" and is_map(other):
        inner = _narrow(other, rest, bound, defs)
        return {**node, "additionalProperties": False if inner is None else inner}
    found: Any = own.get(step, other)
    if not is_map(found):
        return node
    inner = _narrow(found, rest, bound, defs)
    required: list[str] = list(node.get("required", ()))
    if inner is None:
        return None
    if "default" in inner and not _holds(inner["default"], rest, bound):
        inner.pop("default")
        required.append(step)
    elif "default" not in inner and not bound.optional and step not in required:
        required.append(step)
    return {**node, "properties": {**own, step: inner}, "required": required}


def _narrow_array(
    node: Schema, steps: tuple[str, ...], bound: Bound, defs: Schema
) -> Schema | None:
    step, rest = steps[0], steps[1:]
    out = dict(node)
    places: Any = node.get("prefixItems")
    if is_list(places):
        inner = [
            _narrow(item, rest, bound, defs) if step in ("*", str(i)) else item
            for i, item in enumerate(places)
        ]
        if None in inner:
            return None
        out["prefixItems"] = inner
    if is_map(node.get("items")) and step == "*":
        item = _narrow(node["items"], rest, bound, defs)
        out |= {"maxItems": 0} if item is None else {"items": item}
    return out


def _bounded(node: Schema, bound: Bound) -> Schema | None:
    if bound.allow:
        allowed = [value for value in bound.allow if "enum" not in node or value in node["enum"]]
        kept = {key: item for key, item in node.items() if key in _KEPT}
        return {**kept, "enum": allowed} if allowed else None
    if node.get("type") == "string" and "pattern" in node:  # a long integer, spelled
        return node
    if node.get("type", "number") not in ("number", "integer") or "enum" in node:
        return None
    out = {"type": "number", **node}
    if bound.min is not None:
        out["minimum"] = max(bound.min, node.get("minimum", bound.min))
    if bound.max is not None:
        out["maximum"] = min(bound.max, node.get("maximum", bound.max))
    return out


def _holds(default: Any, steps: tuple[str, ...], bound: Bound) -> bool:
    """Return whether omitting a field satisfies the bound."""
    return all(within(found, bound) for _, found in Field(".".join(steps)).every(default))


def _resolved(node: Any, defs: Schema) -> Schema:
    """Return a node with its reference resolved."""
    out: Schema = dict(node) if is_map(node) else {}
    while (ref := out.pop("$ref", None)) is not None:
        out = {**defs.get(ref.rpartition("/")[2], {}), **out}
    return out
