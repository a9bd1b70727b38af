"""Go output: structures, a variable for each path that says what may be done with it, and a small client.

It needs nothing but Go's own library, from 1.19 on.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import msgspec

from rcp_client.codegen.runtime import runtime
from rcp_client.codegen.types import Record, Shape, Types, class_name, groups, one_line
from rcp_client.messages import ResourceInfo

__all__ = ["write_go"]

_WORDS = {
    "any": "any",
    "null": "any",
    "bool": "bool",
    "int": "int64",
    "long": "Int",
    "ulong": "Uint",
    "float": "Float",
    "str": "string",
    "bytes": "[]byte",
}
_FILES = ("values.go", "gateway.go", "resources.go", "commands.go", "leases.go")
_PREAMBLE = re.compile(r"package rcp\n\nimport \((.*?)\)\n", re.DOTALL)
_RESERVED = (
    "Gateway", "New", "Error", "Float", "Int", "Uint", "Readable", "Writable", "Setting", "Command", "Update",
    "Some", "Lease", "Acquire", "WithKey",
)  # fmt: skip
"""Names that no type of a gateway may have."""
_LITERALS = {str: "string", bool: "bool", int: "int64"}


def write_go(resources: list[ResourceInfo], url: str) -> str:
    """Generate the file of a package `rcp`."""
    types = Types()
    for word in _RESERVED:
        types.take_name(word)
    files = [runtime("go", name) for name in _FILES]
    rows = [row for one in groups(resources).items() for row in _rows(types, *one)]
    text = [
        runtime("go", "head.go").replace("URL", one_line(url)),
        _imports(files),
        *(_record(record, types.records) for record in types.records.values()),
        "var (\n" + "\n".join(rows) + "\n)",
        *(_PREAMBLE.sub("", file) for file in files),
    ]
    return "\n\n".join(part.strip("\n") for part in text) + "\n"


def _imports(files: list[str]) -> str:
    """Return the one import declaration of what were several files."""
    used = {line for file in files for line in _PREAMBLE.findall(file)[0].split("\n") if line}
    return "\n".join(["import (", *sorted(used), ")"])


def _rows(types: Types, owner: str, members: list[tuple[str, ResourceInfo]]) -> Iterator[str]:
    for short, resource in members:
        path, schemas = msgspec.json.encode(resource.path).decode(), resource.schemas
        value = schemas.get("value") or schemas.get("output")
        sent = _text(types.shape(value, inward=False)) if value else "any"
        taken = _text(types.shape(value, inward=True)) if value else "any"
        reads = bool({"read", "subscribe"} & set(resource.operations))
        writes = "write" in resource.operations
        if "execute" in resource.operations:
            given = _text(types.shape(schemas.get("input"), inward=True))
            made = _text(types.shape(schemas.get("output"), inward=False))
            code = f"Command[{given}, {made}]{{{path}}}"
        elif reads and writes:
            readable, writable = f"Readable[{sent}]{{{path}}}", f"Writable[{taken}]{{{path}}}"
            code = f"Setting[{sent}, {taken}]{{{readable}, {writable}}}"
        elif writes:
            code = f"Writable[{taken}]{{{path}}}"
        elif reads:
            code = f"Readable[{sent}]{{{path}}}"
        else:
            continue
        if resource.description:
            yield f"\t// {one_line(resource.description)}"
        yield f"\t{types.take_name(class_name(f'{owner}_{short}'))} = {code}"


def _text(shape: Shape) -> str:
    match shape.kind:
        case "literal":
            kinds = {type(value) for value in shape.values}
            return _LITERALS.get(kinds.pop(), "any") if len(kinds) == 1 else "any"
        case "list":
            return f"[]{_text(shape.parts[0])}"
        case "map":
            return f"map[string]{_text(shape.parts[0])}"
        case "union":
            return _optional(_text(held)) if (held := _nullable(shape)) else "any"
        case "name":
            return shape.name
        case kind:
            return _WORDS[kind]


def _nullable(shape: Shape) -> Shape | None:
    """Return what a union holds besides null, if that is one type."""
    held = [part for part in shape.parts if part.kind != "null"]
    return held[0] if len(held) == 1 else None


def _optional(text: str) -> str:
    return text if text == "any" or text.startswith("*") else f"*{text}"


def _record(record: Record, records: dict[str, Record]) -> str:
    lines = [f"// {record.note}"] if record.note else []
    lines.append(f"type {record.name} struct {{")
    taken: set[str] = set()
    for field in record.fields:
        text = _text(field.shape)
        if field.optional or _holds(field.shape, record.name, records):
            text = _optional(text)
        name = class_name(field.name)
        while name in taken:
            name += "_"
        taken.add(name)
        given = f"{field.name},omitempty" if field.optional else field.name
        tag = msgspec.json.encode(f"json:{msgspec.json.encode(given).decode()}").decode()
        note = f" // {field.note}" if field.note else ""
        lines.append(f"\t{name} {text} {tag}{note}")
    return "\n".join([*lines, "}"])


def _holds(shape: Shape, name: str, records: dict[str, Record]) -> bool:
    """Return whether a record would hold itself by value."""
    waiting, seen = [shape], set[str]()
    while waiting:
        one = waiting.pop()
        if one.kind != "name" or one.name in seen:
            continue
        if one.name == name:
            return True
        seen.add(one.name)
        waiting += [field.shape for field in records[one.name].fields if not field.optional]
    return False
