"""The schema of a goal that may be on the earth or at a named place, for forms and models."""

from __future__ import annotations

from typing import Any

from rcp_frames.config import EARTH
from rcp_protocol.plain import is_map

__all__ = ["Schema", "resolved", "widened"]

Schema = dict[str, Any]
_ON_EARTH: Schema = {
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
_EARTH_NEEDS = ["latitude", "longitude"]
_AT_PLACE: Schema = {
    "place": {
        "type": "string",
        "maxLength": 64,
        "description": "Name of one of `/system/places`, instead of coordinates and `frame`.",
    },
    "distance": {
        "type": "number",
        "minimum": 0,
        "maximum": 1000,
        "unit": "m",
        "description": "With `place`: stay this far from it, on the robot's side, facing it.",
    },
}


def widened(schema: Schema, *, earth: bool, places: bool) -> Schema | None:
    """Return the schema of a goal whose position may be on the earth or a place; None: as it is.

    One object with the fields of all forms, because forms and models fill in fields: which belong
    together is told beside them.
    """
    defs: Schema = schema.get("$defs", {})
    goal = resolved(schema, defs)
    fields: Schema = goal.get("properties", {})
    position = resolved(fields.get("position"), defs)
    position.pop("default", None)
    frames = resolved(fields.get("frame"), defs).get("enum", [EARTH])
    own: Any = position.get("properties")
    if not is_map(own):
        return None
    added: Schema = {}
    needs: list[list[str]] = [position.pop("required", [])]
    if earth and EARTH in frames and not own.keys() & _ON_EARTH.keys():
        added |= _ON_EARTH
        needs.append(_EARTH_NEEDS)
        position["dependentRequired"] = {"altitude": _EARTH_NEEDS}
    if places and not own.keys() & _AT_PLACE.keys():
        added |= _AT_PLACE
        needs.append(["place"])
    if not added:
        return None
    position["properties"] = {**own, **added}
    position["oneOf"] = [{"required": one} for one in needs]
    goal["properties"] = {**fields, "position": position}
    return {key: item for key, item in goal.items() if key != "$id"}


def resolved(node: Any, defs: Schema) -> Schema:
    """Return a schema without references, and without the choice of null."""
    out: Schema = dict(node) if is_map(node) else {}
    choices = [one for one in out.get("anyOf", ()) if one != {"type": "null"}]
    if len(choices) == 1:
        del out["anyOf"]
        out = {**choices[0], **out}
    while (ref := out.pop("$ref", None)) is not None:
        out = {**defs.get(ref.rpartition("/")[2], {}), **out}
    return out
