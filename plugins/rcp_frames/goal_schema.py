"""The schema of a goal that may be a place on the earth, for forms and models."""

from __future__ import annotations

from typing import Any

from rcp_frames.config import EARTH
from rcp_protocol.plain import is_map

__all__ = ["with_earth"]

Schema = dict[str, Any]
_PLACE: Schema = {
    "latitude": {
        "type": "number",
        "minimum": -90,
        "maximum": 90,
        "unit": "deg",
        "description": "With `frame` `earth`, and `longitude`: instead of x and y.",
    },
    "longitude": {"type": "number", "minimum": -180, "maximum": 180, "unit": "deg"},
    "altitude": {
        "anyOf": [{"type": "number", "unit": "m"}, {"type": "null"}],
        "default": None,
        "description": "Above mean sea level. Null: an aircraft keeps its height.",
    },
}
_NEEDED = ["latitude", "longitude"]


def with_earth(schema: Schema) -> Schema | None:
    """Return the schema of a goal whose position may be latitude and longitude; None: it cannot be.

    One object with the fields of both forms, because forms and models fill in fields: which belong
    together is told beside them.
    """
    defs: Schema = schema.get("$defs", {})
    goal = _resolved(schema, defs)
    fields: Schema = goal.get("properties", {})
    position = _resolved(fields.get("position"), defs)
    frames = _resolved(fields.get("frame"), defs).get("enum", [EARTH])
    own: Any = position.get("properties")
    if EARTH not in frames or not is_map(own) or own.keys() & _PLACE.keys():
        return None
    needed: list[str] = position.pop("required", [])
    position["properties"] = {**own, **_PLACE}
    position["oneOf"] = [{"required": needed}, {"required": _NEEDED}]
    position["dependentRequired"] = {"altitude": _NEEDED}
    goal["properties"] = {**fields, "position": position}
    return {key: item for key, item in goal.items() if key != "$id"}


def _resolved(node: Any, defs: Schema) -> Schema:
    out: Schema = dict(node) if is_map(node) else {}
    while (ref := out.pop("$ref", None)) is not None:
        out = {**defs.get(ref.rpartition("/")[2], {}), **out}
    return out
