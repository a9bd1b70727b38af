"""Profiles as Markdown pages, generated from their documents."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

from rcp_profiles.document import document
from rcp_profiles.profile import Profile

__all__ = ["index", "page"]

_BEHAVIOUR = {
    "valid_for": "valid for {} s unless the robot or the client says otherwise",
    "max_age": "refused when older than {} s",
    "timeout": "takes at most {} s",
}
_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


def index(profiles: Iterable[Profile]) -> str:
    """Return the page that lists profiles."""
    rows = [
        f"| [`{one.name}`]({one.name}.md) | {one.version} | {one.description} |" for one in profiles
    ]
    return "\n".join(["| profile | version | |", "|---|---|---|", *rows, ""])


def page(profile: Profile) -> str:
    """Return the page of a profile."""
    made = document(profile)
    facts: dict[str, Any] = made["x-rcp-profile"]
    lines = [
        f"# Profile `{profile.name}`",
        "",
        f"{profile.description} Version {profile.version}, schema `{made['$id']}`.",
        "",
    ]
    if profile.includes:
        names = ", ".join(f"[`{one.id}`]({one.name}.md)" for one in profile.includes)
        lines += [f"A robot that claims it also has {names}.", ""]
    lines += ["| resource | | operations | frame | meaning |", "|---|---|---|---|---|"]
    resources: dict[str, Any] = facts["resources"]
    lines += [_row(name, one) for name, one in resources.items()]
    for name, one in resources.items():
        lines += _resource(name, one, made["$defs"])
    return "\n".join([*lines, ""])


def _row(name: str, one: dict[str, Any]) -> str:
    need = "required" if one["required"] else "optional"
    need = "from the gateway" if one.get("gateway") else need
    frame = f"`{one['frame']}`" if "frame" in one else ""
    operations = ", ".join(one["operations"])
    return f"| `{name}` | {need} | {operations} | {frame} | {one['description']} |"


def _resource(name: str, one: dict[str, Any], types: dict[str, Any]) -> Iterator[str]:
    yield from ("", f"## `{name}`", "", one["description"])
    notes = [text.format(f"{one[k]:g}") for k, text in _BEHAVIOUR.items() if k in one]
    if one.get("energises"):
        notes.append("energises: refused during an e-stop")
    if notes:
        yield from ("", f"{'; '.join(notes).capitalize()}.")
    for part, id_ in one["schemas"].items():
        yield from ("", f"**{part.capitalize()}** `{types[id_].get('title', part)}`", "")
        yield from ("| field | type | unit | |", "|---|---|---|---|")
        yield from _fields(types[id_], types[id_], "")
    if one.get("examples"):
        yield from ("", "Example:", "", "```json", json.dumps(one["examples"][0]), "```")


def _fields(schema: dict[str, Any], root: dict[str, Any], place: str) -> Iterator[str]:
    """Yield a row for each field, nested ones under their dotted names."""
    facts = _resolved(schema, root)
    shown = _kind(facts, root)
    if place or facts.get("type") != "object":
        unit = facts.get("unit", "")
        note = facts.get("description", "") if shown != "object" or "$ref" not in schema else ""
        note = schema.get("description", note)
        yield f"| {f'`{place}`' if place else 'the value'} | {shown} | {unit} | {note} |"
    inner = facts
    if facts.get("type") == "array":
        inner, place = _resolved(facts.get("items", {}), root), f"{place}[]"
    for name, one in inner.get("properties", {}).items():
        yield from _fields(one, root, f"{place}.{name}" if place else name)


def _resolved(schema: dict[str, Any], root: dict[str, Any]) -> dict[str, Any]:
    """Resolve a reference, and skip `null` among the options."""
    if "$ref" in schema:
        target: Any = root
        for step in schema["$ref"].removeprefix("#/").split("/"):
            target = target[step]
        return _resolved({**target, **{k: v for k, v in schema.items() if k != "$ref"}}, root)
    options = [one for one in schema.get("anyOf", ()) if one != {"type": "null"}]
    if len(options) == 1:
        rest = {k: v for k, v in schema.items() if k != "anyOf"}
        return _resolved({**options[0], **rest, "nullable": True}, root)
    return schema


def _in_unit(facts: dict[str, Any]) -> str:
    return f" ({facts['unit']})" if "unit" in facts else ""


def _kind(facts: dict[str, Any], root: dict[str, Any]) -> str:
    if "enum" in facts:
        words = ", ".join(f"`{word}`" for word in facts["enum"])
    elif "anyOf" in facts:
        words = " or ".join(_kind(_resolved(one, root), root) for one in facts["anyOf"])
    else:
        words = facts.get("type", "any")
    if words == "array":
        one = _resolved(facts.get("items", {}), root)
        words = f"list of {_kind(one, root)}{_in_unit(one)}"
    elif facts.get("additionalProperties") not in (None, True, False):
        one = _resolved(facts["additionalProperties"], root)
        words = f"map of {_kind(one, root)}{_in_unit(one)}"
    bounds = [f"{sign} {facts[name]:g}" for name, sign in _BOUNDS.items() if name in facts]
    text = ", ".join([words, *bounds])
    if facts.get("nullable"):
        text += " or null"
    default = facts.get("default")
    if default is not None and not isinstance(default, dict):
        text += f", default `{json.dumps(default)}`"
    return text
