"""The limits that the input of a resource declares."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rcp_kernel.model import Kind
from rcp_kernel.tree.entry import Entry

__all__ = ["Limits", "frames_of", "limits_of"]

Limits = dict[str, tuple[float | None, float | None]]

_DEEPEST = 4  # levels of a value that are looked into
_MOST = 32  # limits of one resource
_COMMANDED = frozenset((Kind.ACTUATOR, Kind.PARAM))
_CALLED = frozenset((Kind.ACTION, Kind.SERVICE))
_FRAMES = ("frame_id", "frame")
_Schema = dict[str, Any]


def limits_of(entry: Entry) -> Limits:
    """Return the limits of what clients may send, by field; an upper limit is what counts."""
    if entry.kind in _COMMANDED:
        schema = entry.value_type.schema
    elif entry.kind in _CALLED and entry.resource.input is not None:
        schema = entry.input_type.schema
    else:
        return {}
    found: Limits = {}
    for field, low, high in _bounds(schema, schema.get("$defs", {}), "", 0):
        if len(found) == _MOST:
            break
        found[field or "value"] = (None if low is None else low or 0, high or 0)  # no -0.0
    return found


def frames_of(entry: Entry) -> Iterator[str]:
    """Iterate over the frames that are the defaults of a resource's values and goals."""
    for type_ in (entry.value_type, entry.input_type):
        schema = type_.schema
        properties = _resolved(schema, schema.get("$defs", {})).get("properties", {})
        for name in _FRAMES:
            frame = properties.get(name, {}).get("default")
            if isinstance(frame, str):
                yield frame


def _resolved(schema: _Schema, known: _Schema) -> _Schema:
    """Follow references and optional types to the schema that has the fields or the limits."""
    for _ in range(_DEEPEST):
        if (ref := schema.get("$ref")) is not None:
            schema = {**known.get(ref.rpartition("/")[2], {}), **_own(schema, "$ref")}
        elif several := schema.get("anyOf") or schema.get("oneOf") or schema.get("allOf"):
            typed = [one for one in several if one.get("type") != "null"]
            if len(typed) != 1:
                break
            schema = {**typed[0], **_own(schema, "anyOf", "oneOf", "allOf")}
        else:
            break
    return schema


def _own(schema: _Schema, *without: str) -> _Schema:
    return {name: value for name, value in schema.items() if name not in without}


def _bounds(
    schema: _Schema, known: _Schema, field: str, depth: int
) -> Iterator[tuple[str, float | None, float]]:
    schema = _resolved(schema, known)
    high = schema.get("maximum", schema.get("exclusiveMaximum"))
    if high is not None:
        yield field, schema.get("minimum", schema.get("exclusiveMinimum")), high
    if depth < _DEEPEST:
        for name, inner in schema.get("properties", {}).items():
            yield from _bounds(inner, known, f"{field}.{name}" if field else name, depth + 1)
