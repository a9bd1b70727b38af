"""The types of a catalogue: JSON Schemas reduced to what the target languages have in common.

Values sent by the gateway have every field; values it accepts may omit those with a default. A type
with such fields therefore has two forms, `Pose` and `PoseIn`.
"""

from __future__ import annotations

import hashlib
import keyword
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import msgspec

from rcp_client.messages import ResourceInfo

__all__ = ["Field", "Record", "Shape", "Types", "class_name", "groups", "identifier", "one_line"]

_ODD_FLOATS = {"NaN", "Infinity", "-Infinity"}


@dataclass(frozen=True)
class Shape:
    """A type, independent of the language."""

    kind: str
    """any, null, bool, int, long, ulong, float, str, bytes, literal, list, map, name, or union.

    A long may be beyond the integers that JSON carries exactly, a ulong also beyond the signed ones.
    """
    parts: tuple[Shape, ...] = ()
    """Item type of a list or map, options of a union."""
    values: tuple[Any, ...] = ()
    """Values of a literal."""
    name: str = ""


ANY, NULL = Shape("any"), Shape("null")
_INT, _LONG, _ULONG = Shape("int"), Shape("long"), Shape("ulong")
_SIMPLE = {"null": "null", "boolean": "bool", "integer": "int", "number": "float"}


@dataclass
class Field:
    """One field of a record."""

    name: str
    shape: Shape
    optional: bool
    note: str
    """Unit and description, on one line."""


@dataclass
class Record:
    """A type with named fields."""

    name: str
    note: str
    fields: list[Field] = field(default_factory=list[Field])


class Types:
    """All records of a catalogue, each with a unique name."""

    def __init__(self) -> None:
        self.records: dict[str, Record] = {}
        self._names: dict[tuple[str, str, bool], str] = {}
        self._taken: set[str] = set()

    def take_name(self, wanted: str) -> str:
        """Reserve a name; append a number if it is taken."""
        name, count = wanted, 1
        while name in self._taken:
            count += 1
            name = f"{wanted}{count}"
        self._taken.add(name)
        return name

    def shape(self, schema: dict[str, Any] | None, *, inward: bool) -> Shape:
        """Return the type of a schema, as the gateway accepts it (`inward`) or sends it."""
        if schema is None:
            return NULL
        return self._shape(schema, schema.get("$defs", {}), inward=inward)

    def _shape(self, node: dict[str, Any], defs: dict[str, Any], *, inward: bool) -> Shape:
        if (reference := node.get("$ref")) is not None:
            return self._named(reference.rpartition("/")[2], defs, inward=inward)
        if (options := node.get("anyOf") or node.get("oneOf")) is not None:
            return self._union(options, defs, inward=inward)
        if "const" in node:
            return Shape("literal", values=(node["const"],))
        if "enum" in node:
            return Shape("literal", values=tuple(node["enum"]))
        match node.get("type"):
            case "string":
                return Shape("bytes" if node.get("contentEncoding") == "base64" else "str")
            case "array":
                items = node.get("items")
                held = self._shape(items, defs, inward=inward) if items else ANY
                return Shape("list", (held,))
            case "object":
                items = node.get("additionalProperties")
                held = self._shape(items, defs, inward=inward) if isinstance(items, dict) else ANY
                return Shape("map", (held,))
            case str() as kind if kind in _SIMPLE:
                return Shape(_SIMPLE[kind])
            case list() as kinds:
                return self._union([{"type": kind} for kind in kinds], defs, inward=inward)
            case _:
                return ANY

    def _union(self, options: list[Any], defs: dict[str, Any], *, inward: bool) -> Shape:
        found: list[Shape] = []
        patterns = [option.get("pattern", "") for option in options]
        long = any(pattern.startswith("^-?[0-9]{1,") for pattern in patterns)
        ulong = any(pattern.startswith("^[0-9]{1,") for pattern in patterns)
        for option, pattern in zip(options, patterns, strict=True):
            spelled = set(option.get("enum", ())) == _ODD_FLOATS
            if spelled or pattern.startswith(("^-?[0-9]{1,", "^[0-9]{1,")):
                continue  # alternative JSON spellings of numbers
            shape = self._shape(option, defs, inward=inward)
            if shape == _INT and (long or ulong):
                shape = _ULONG if ulong else _LONG
            if shape not in found:
                found.append(shape)
        if ANY in found or not found:
            return ANY
        return found[0] if len(found) == 1 else Shape("union", tuple(found))

    def _named(self, name: str, defs: dict[str, Any], *, inward: bool) -> Shape:
        node = defs.get(name)
        if not isinstance(node, dict):
            return ANY
        if "properties" not in node:
            return self._shape(node, defs, inward=inward)
        inward = inward and any(_has_optional(defs[n]) for n in _reach(name, defs))
        key = (name, _digest(name, defs), inward)
        known = self._names.get(key)
        if known is None:
            wanted = class_name(name) + ("In" if inward else "")
            known = self._names[key] = self.take_name(wanted)
            record = self.records[known] = Record(known, one_line(node.get("description", "")))
            required = set(node.get("required", ()))
            for field_name, part in node["properties"].items():
                shape = self._shape(part, defs, inward=inward)
                optional = inward and field_name not in required
                record.fields.append(Field(field_name, shape, optional, _note(part)))
        return Shape("name", name=known)


def _has_optional(node: dict[str, Any]) -> bool:
    return node.get("properties", {}).keys() > set(node.get("required", ()))


def _reach(name: str, defs: dict[str, Any]) -> set[str]:
    """Return the names that a definition refers to, including itself."""
    found, waiting = set[str](), [name]
    while waiting:
        current = waiting.pop()
        if current in found or not isinstance(defs.get(current), dict):
            continue
        found.add(current)
        waiting += _references(defs[current])
    return found


def _references(node: Any) -> Iterator[str]:
    if isinstance(node, dict):
        if isinstance(node.get("$ref"), str):
            yield node["$ref"].rpartition("/")[2]
        for part in node.values():
            yield from _references(part)
    elif isinstance(node, list):
        for part in node:
            yield from _references(part)


def _digest(name: str, defs: dict[str, Any]) -> str:
    """Return a digest that distinguishes definitions with the same name."""
    whole = {known: defs[known] for known in sorted(_reach(name, defs))}
    return hashlib.sha256(msgspec.json.encode(whole, order="sorted")).hexdigest()


def _note(node: dict[str, Any]) -> str:
    options = [node, *(o for o in node.get("anyOf", ()) if isinstance(o, dict))]
    unit = next((o["unit"] for o in options if o.get("unit")), "")
    facts = ["" if unit == "1" else str(unit), str(node.get("description", ""))]
    return one_line("; ".join(fact for fact in facts if fact))


def one_line(text: str) -> str:
    """Make a text safe for a comment: one line, without comment delimiters."""
    plain = re.sub(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\s]+", " ", text).strip()
    return plain.replace("*/", "* /").replace("\\", "/").replace('"""', "'''")


def identifier(text: str) -> str:
    """Convert a text to an identifier that is valid in every target language."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_") or "_"
    return f"_{name}" if name[0].isdigit() else name + "_" * keyword.iskeyword(name)


def class_name(text: str) -> str:
    """Convert a text to a class name."""
    parts = [part for part in re.split(r"[^A-Za-z0-9]+", text) if part]
    name = "".join(part[0].upper() + part[1:] for part in parts) or "Type"
    return f"T{name}" if name[0].isdigit() else name


def groups(resources: list[ResourceInfo]) -> dict[str, list[tuple[str, ResourceInfo]]]:
    """Group resources by tenant, each with a short name that is unique there."""
    sorted_: dict[str, list[ResourceInfo]] = {}
    for resource in resources:
        parts = resource.path.split("/")
        owner = parts[2] if parts[1] == "tenant" else "system"
        sorted_.setdefault(owner, []).append(resource)
    order = sorted(sorted_, key=lambda owner: owner == "system")
    return {owner: _short_names(sorted_[owner]) for owner in order}


def _short_names(members: list[ResourceInfo]) -> list[tuple[str, ResourceInfo]]:
    def name(resource: ResourceInfo, skip: int) -> str:
        parts = resource.path.split("/")[1:]
        rest = parts[skip:] if parts[0] == "tenant" else parts[1:]
        return identifier("_".join(rest)).lower()

    short = [name(member, 3) for member in members]
    named: list[tuple[str, ResourceInfo]] = []
    taken = set[str]()
    for member, wanted in zip(members, short, strict=True):
        chosen = wanted if short.count(wanted) == 1 else name(member, 2)
        while chosen in taken:
            chosen += "_"
        taken.add(chosen)
        named.append((chosen, member))
    return named
