"""Profiles as documents: JSON Schema with an id and a version, and what changed between two."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, cast

from rcp_profiles.compatibility import unaccepted, unexpected
from rcp_profiles.profile import Definition, Profile
from rcp_protocol.model import kind_of, operation_names
from rcp_protocol.values import to_plain, value_type

__all__ = ["Change", "changes", "document", "unannounced"]

_PARTS = ("value", "input", "output", "feedback")
_WORDS = ("$id", "title", "description", "examples")
_BEHAVIOUR = ("valid_for", "max_age", "timeout")
_PROMISES = ("kind", "frame", "energises", "gateway")


class Change(NamedTuple):
    """One difference between two documents of a profile."""

    text: str
    breaks: bool
    """Whether clients or robots of the older version are affected."""


def document(profile: Profile) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a profile.

    Its instances are objects with the values of a robot's resources by name; `$defs` has the type of each
    value, input, output and feedback, and `x-rcp-profile` what no schema says.
    """
    types: dict[str, Any] = {}
    resources = {one.name: _resource(one, types) for one in profile.resources}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"rcp:profile:{profile.id}",
        "title": profile.name,
        "description": profile.description,
        "type": "object",
        "properties": {
            name: {"$ref": one["schemas"]["value"]}
            for name, one in resources.items()
            if "value" in one["schemas"]
        },
        "x-rcp-profile": {
            "name": profile.name,
            "version": profile.version,
            "includes": [one.id for one in profile.includes],
            "resources": resources,
        },
        "$defs": types,
    }


def _resource(definition: Definition, types: dict[str, Any]) -> dict[str, Any]:
    resource = definition.resource
    schemas: dict[str, str] = {}
    for part in _PARTS:
        if (type_ := getattr(resource, part)) is not None:
            schema = value_type(type_).schema
            types[schema["$id"]] = schema
            schemas[part] = schema["$id"]
    found: dict[str, Any] = {
        "kind": kind_of(resource.name).value,
        "description": resource.description,
        "required": definition.required,
        "operations": operation_names(definition.operations),
        "schemas": schemas,
    }
    found |= {n: v for n in _BEHAVIOUR if (v := getattr(resource, n)) is not None}
    if definition.frame is not None:
        found["frame"] = definition.frame
    if definition.gateway:
        found["gateway"] = True
    if resource.safe is not None:
        found["safe"] = to_plain(resource.safe)
    if resource.energises:
        found["energises"] = True
    if resource.examples:
        found["examples"] = list(to_plain(resource.examples))
    return found


def changes(old: dict[str, Any], new: dict[str, Any]) -> list[Change]:
    """List the changes in `new`, by their effect on users of `old`."""
    mine: dict[str, Any] = old["x-rcp-profile"]
    theirs: dict[str, Any] = new["x-rcp-profile"]
    found = [
        Change(f"it includes {name} no longer", breaks=True)
        for name in mine["includes"]
        if name not in theirs["includes"]
    ]
    found += [
        Change(f"it includes {name}", breaks=True)
        for name in theirs["includes"]
        if name not in mine["includes"]
    ]
    for name, one in mine["resources"].items():
        other = theirs["resources"].get(name)
        if other is None:
            found.append(Change(f"{name} is gone", breaks=True))
        elif one != other:
            found += _changed(name, (one, old), (other, new))
    found += [
        Change(f"{name} is new", breaks=one["required"])
        for name, one in theirs["resources"].items()
        if name not in mine["resources"]
    ]
    return found


def unannounced(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """List the changes that are incompatible with the version number of `new`."""
    before, after = (_version(one) for one in (old, new))
    if after[0] > before[0]:
        return []
    if after > before:
        return [change.text for change in changes(old, new) if change.breaks]
    return [change.text for change in changes(old, new)]


def _version(whole: dict[str, Any]) -> tuple[int, ...]:
    return tuple(map(int, whole["x-rcp-profile"]["version"].split(".")))


def _changed(
    name: str,
    old: tuple[dict[str, Any], dict[str, Any]],
    new: tuple[dict[str, Any], dict[str, Any]],
) -> Iterator[Change]:
    """Yield the changes of one resource, each with the document that contains it."""
    (mine, before), (theirs, after) = old, new
    for fact in _PROMISES:
        if mine.get(fact) != theirs.get(fact):
            text = f"{name}: {fact} is {theirs.get(fact)}, not {mine.get(fact)}"
            yield Change(text, breaks=True)
    if mine["required"] != theirs["required"]:
        word = "required" if theirs["required"] else "optional"
        yield Change(f"{name} is {word} now", breaks=True)
    for one in mine["operations"]:
        if one not in theirs["operations"]:
            yield Change(f"{name} does not offer {one}", breaks=True)
    for one in theirs["operations"]:
        if one not in mine["operations"]:
            yield Change(f"{name} offers {one}", breaks=True)
    writable = "write" in mine["operations"]
    for part in _PARTS:
        yield from _type_changed(
            f"{name}, {part}",
            _schema(before, mine, part),
            _schema(after, theirs, part),
            sent=part == "input" or writable,
            received=part != "input",
        )
    for fact in ("description", "safe", "examples", *_BEHAVIOUR):
        if mine.get(fact) != theirs.get(fact):
            yield Change(f"{name}: {fact} has changed", breaks=False)


def _schema(whole: dict[str, Any], one: dict[str, Any], part: str) -> dict[str, Any] | None:
    id_ = one["schemas"].get(part)
    return None if id_ is None else whole["$defs"][id_]


def _type_changed(
    what: str,
    old: dict[str, Any] | None,
    new: dict[str, Any] | None,
    *,
    sent: bool,
    received: bool,
) -> Iterator[Change]:
    if _without_words(old) == _without_words(new):
        return
    if old is None or new is None:
        yield Change(f"{what} is {'new' if old is None else 'gone'}", breaks=True)
        return
    broken = unaccepted(old, new) if sent else []
    if received:
        broken += [one for one in unexpected(old, new) if one not in broken]
    for text in broken:
        yield Change(f"{what}: {text}", breaks=True)
    if not broken:
        yield Change(f"{what} is wider", breaks=False)


def _without_words(schema: Any) -> Any:
    """Drop the descriptions of a type: wording may change without a new version."""
    if isinstance(schema, list):
        return [_without_words(item) for item in cast("list[Any]", schema)]
    if not isinstance(schema, dict):
        return schema
    items = cast("dict[str, Any]", schema).items()
    return {
        key: {name: _without_words(one) for name, one in item.items()}  # names, not words
        if key in ("properties", "$defs")
        else _without_words(item)
        for key, item in items
        if key not in _WORDS
    }
