"""TypeScript output: interfaces, maps from path to type, and a small client over HTTP and SSE.

The npm package `rcp-client` uses the same maps to check paths and values.

Only erasable syntax is used, so that Node and bundlers run it unchanged.
"""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from rcp_client.codegen.runtime import runtime
from rcp_client.codegen.types import Record, Shape, Types, one_line
from rcp_client.messages import ResourceInfo

__all__ = ["write_typescript"]

_WORDS = {
    "any": "unknown",
    "null": "null",
    "bool": "boolean",
    "int": "number",
    "long": "Integer",
    "ulong": "Integer",
    "float": "Float",
    "str": "string",
    "bytes": "Base64",
}
_RESERVED = ("Values", "Writes", "Commands", "Gateway", "Update", "Reply", "Rcp", "RcpError", "Float",
             "Integer", "Base64", "Record", "Promise", "Array", "AsyncGenerator", "Error")  # fmt: skip


def write_typescript(resources: list[ResourceInfo], url: str) -> str:
    """Generate the module."""
    types = Types()
    for word in _RESERVED:
        types.take_name(word)
    values: list[tuple[str, str, str]] = []
    writes: list[tuple[str, str, str]] = []
    commands: list[tuple[str, str, str]] = []
    for resource in resources:
        schemas, note = resource.schemas, one_line(resource.description)
        value = schemas.get("value") or schemas.get("output")
        if {"read", "subscribe"} & set(resource.operations):
            text = _text(types.shape(value, inward=False)) if value else "unknown"
            values.append((resource.path, text, note))
        if "write" in resource.operations:
            text = _text(types.shape(value, inward=True)) if value else "unknown"
            writes.append((resource.path, text, note))
        if "execute" in resource.operations:
            taken = _text(types.shape(schemas.get("input"), inward=True))
            given = _text(types.shape(schemas.get("output"), inward=False))
            fed = _text(types.shape(schemas.get("feedback"), inward=False))
            text = f"{{ input: {taken}; output: {given}; feedback: {fed} }}"
            commands.append((resource.path, text, note))
    parts = [
        runtime("typescript", "head.ts").replace("URL", one_line(url)),
        *map(_record, types.records.values()),
        _map("Values", "What can be read and watched, by path.", values),
        _map("Writes", "What can be written, by path.", writes),
        _map("Commands", "What can be executed, by path.", commands),
        runtime("typescript", "gateway.ts"),
        runtime("typescript", "client.ts"),
    ]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _quoted(text: str) -> str:
    return msgspec.json.encode(text).decode()


def _text(shape: Shape) -> str:
    match shape.kind:
        case "literal":
            return " | ".join(msgspec.json.encode(value).decode() for value in shape.values)
        case "list":
            return f"Array<{_text(shape.parts[0])}>"
        case "map":
            return f"Record<string, {_text(shape.parts[0])}>"
        case "union":
            return " | ".join(map(_text, shape.parts))
        case "name":
            return shape.name
        case kind:
            return _WORDS[kind]


def _record(record: Record) -> str:
    lines = [f"/** {record.note} */"] if record.note else []
    lines.append(f"export interface {record.name} {{")
    for field in record.fields:
        if field.note:
            lines.append(f"  /** {field.note} */")
        mark = "?" if field.optional else ""
        lines.append(f"  {_quoted(field.name)}{mark}: {_text(field.shape)};")
    return "\n".join([*lines, "}"])


def _map(name: str, about: str, rows: Iterable[tuple[str, str, str]]) -> str:
    lines = [f"/** {about} */", f"export interface {name} {{"]
    for path, text, note in rows:
        if note:
            lines.append(f"  /** {note} */")
        lines.append(f"  {_quoted(path)}: {text};")
    return "\n".join([*lines, "}"])
