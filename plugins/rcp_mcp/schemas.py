"""Schemas in the form that tools need: a self-contained object, with units as text."""

from __future__ import annotations

from typing import Any, NamedTuple

from rcp_protocol.plain import is_list, is_map

__all__ = ["Arguments", "arguments", "result", "without_defaults", "worded"]

_DEFS = "$defs"
_DATA = ("default", "examples", "enum", "const", "required")
"""Keys whose content is values and not schemas."""


class Arguments(NamedTuple):
    """The arguments of a tool, and their conversion to the input of its command."""

    schema: dict[str, Any]
    wrapped: bool
    """Whether the input is not an object; then it is the argument `value`."""
    optional: bool
    """Whether a call without arguments has no input."""
    options: frozenset[str]
    """Properties that are options of the call and not part of the input."""


def arguments(
    schema: dict[str, Any] | None, examples: list[Any], extra: dict[str, dict[str, Any]]
) -> Arguments:
    """Build a tool's input schema from that of a command; `extra` are options of the call.

    A field takes precedence over an option of the same name.
    """
    found, wrapped, optional = _object(schema)
    properties = found.get("properties", {})
    added = {name: option for name, option in extra.items() if name not in properties}
    if added:
        found["properties"] = {**properties, **added}
    if schema is None:
        found["additionalProperties"] = False
    shown = [{"value": one} if wrapped else one for one in examples]
    shown = [one for one in shown if is_map(one)]
    if shown:
        found["examples"] = shown
    return Arguments(worded(_brief(found)), wrapped, optional, frozenset(added))


def _brief(schema: dict[str, Any]) -> dict[str, Any]:
    """Leave out what a model need not read: names of types, and that a field may be null."""
    properties: dict[str, Any] = {}
    for name, one in schema["properties"].items():
        kept = {key: item for key, item in one.items() if (key, item) != ("default", None)}
        choices = kept.get("anyOf", [])
        rest = [item for item in choices if item != {"type": "null"}]
        if len(rest) == 1 and len(choices) > 1:
            del kept["anyOf"]
            kept = {**rest[0], **kept}
        properties[name] = kept
    return {key: item for key, item in schema.items() if key != "title"} | {
        "properties": properties
    }


def without_defaults(node: Any) -> Any:
    """Leave out of a whole schema what a model need not read: see `_brief`."""
    if is_list(node):
        return [without_defaults(item) for item in node]
    if not is_map(node):
        return node
    out: dict[str, Any] = {
        key: item if key in _DATA else without_defaults(item)
        for key, item in node.items()
        if (key, item) not in (("default", None), ("unit", "1"), ("required", []))
        and not (key in ("$id", "title") and isinstance(item, str))
    }
    choices = out.get("anyOf", [])
    rest = [item for item in choices if item != {"type": "null"}]
    if len(rest) == 1 and len(choices) > 1:
        del out["anyOf"]
        out = {**rest[0], **out}
    return out


def result(
    schema: dict[str, Any] | None, feedback: dict[str, Any] | None = None
) -> dict[str, Any] | None:
    """Build the output schema of a command's tool: what only this command has, if anything."""
    defs: dict[str, Any] = {}
    properties: dict[str, Any] = {}
    for name, one in (("result", schema), ("feedback", feedback)):
        if one is None:
            continue
        body, more = _part(one)
        if any(more[name] != defs.get(name, more[name]) for name in more):
            continue  # two types of one name
        defs |= more
        properties[name] = body
    if not properties:
        return None
    out: dict[str, Any] = {"type": "object", "properties": properties}
    if defs:
        out[_DEFS] = defs
    return worded(out)


def worded(node: Any) -> Any:
    """Add units to descriptions, where every model reads them."""
    if is_list(node):
        return [worded(item) for item in node]
    if not is_map(node):
        return node
    out = {key: item if key in _DATA else worded(item) for key, item in node.items()}
    unit = out.get("unit")
    if isinstance(unit, str) and unit != "1":
        text = out.get("description")
        unit_text = f"Unit: {unit}."
        if not isinstance(text, str):
            out["description"] = unit_text
        elif unit_text not in text:
            out["description"] = f"{text} {unit_text}"
    return out


def _part(schema: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split a schema into its own part and its definitions, which go to the root."""
    bare = {key: item for key, item in schema.items() if key not in ("$id", _DEFS)}
    # A field without a value is omitted or null: backends may do either.
    return {"anyOf": [bare, {"type": "null"}]}, dict(schema.get(_DEFS, {}))


def _object(schema: dict[str, Any] | None) -> tuple[dict[str, Any], bool, bool]:
    """Return a schema with an object at its root, and whether it is a wrapper, or optional."""
    if schema is None:
        return {"type": "object", "properties": {}}, False, True
    defs: dict[str, Any] = schema.get(_DEFS, {})
    bare = {key: item for key, item in schema.items() if key not in ("$id", _DEFS)}
    choices = bare.get("anyOf")
    optional = False
    if is_list(choices) and {"type": "null"} in choices:
        rest = [one for one in choices if one != {"type": "null"}]
        optional = True
        if len(rest) == 1:
            bare = {**rest[0], **{k: v for k, v in bare.items() if k != "anyOf"}}
    target = _named(bare, defs)
    if target is not None:
        own = {key: item for key, item in bare.items() if key != "$ref"}
        bare = {**target, **own}
    if bare.get("type") == "object":
        return _with(bare, defs), False, optional
    wrapped = {
        "type": "object",
        "properties": {"value": bare},
        "required": [] if optional else ["value"],
        "additionalProperties": False,
    }
    return _with(wrapped, defs), True, optional


def _named(node: dict[str, Any], defs: dict[str, Any]) -> dict[str, Any] | None:
    ref = node.get("$ref")
    found = defs.get(ref.rpartition("/")[2]) if isinstance(ref, str) else None
    return found if is_map(found) else None


def _with(root: dict[str, Any], defs: dict[str, Any]) -> dict[str, Any]:
    """Add to a root the definitions that it references, and no others."""
    used: dict[str, Any] = {}
    waiting: list[Any] = [root]
    while waiting:
        node = waiting.pop()
        if is_list(node):
            waiting.extend(node)
        elif is_map(node):
            name = node["$ref"].rpartition("/")[2] if isinstance(node.get("$ref"), str) else None
            if name in defs and name not in used:
                used[name] = defs[name]
                waiting.append(defs[name])
            waiting.extend(node.values())
    return {**root, _DEFS: used} if used else dict(root)
