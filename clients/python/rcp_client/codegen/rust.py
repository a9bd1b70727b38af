"""Rust output: structures, a constant for each path that says what may be done with it, and a small client.

It needs nothing but Rust's own library, from 1.63 on.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from rcp_client.codegen.runtime import runtime
from rcp_client.codegen.types import Record, Shape, Types, class_name, groups, one_line
from rcp_client.messages import ResourceInfo

__all__ = ["write_rust"]

_WORDS = {
    "any": "Json",
    "null": "()",
    "bool": "bool",
    "int": "i64",
    "long": "i64",
    "ulong": "u64",
    "float": "f64",
    "str": "String",
    "bytes": "Base64",
}
_PARTS = (
    "json.rs", "parser.rs", "values.rs", "error.rs", "connection.rs", "gateway.rs", "resources.rs",
    "commands.rs", "leases.rs",
)  # fmt: skip
_RESERVED = (
    "Gateway", "Error", "Json", "Value", "Readable", "Writable", "Setting", "Command", "Running",
    "Update", "Reply", "Parser", "Base64", "Vec", "Option", "String", "Box", "Some", "None", "Ok",
    "Err", "Result", "Default", "Self", "BTreeMap", "PhantomData", "Duration", "Instant",
    "TcpStream", "ToSocketAddrs", "Read", "Write", "BufRead", "BufReader", "Clone", "Debug",
    "PartialEq", "From", "Into", "Iterator", "ToString", "Drop", "Fn", "FnMut", "FnOnce", "Copy",
    "Send", "Sync", "Sized", "Lease", "Hold", "HoldState", "Stream", "Target", "Connector",
    "Chunks", "Arc", "Condvar", "Mutex", "Deref",
)  # fmt: skip
"""Names that no type of a gateway may have."""
_LITERALS = {str: "String", bool: "bool", int: "i64"}
_KEYWORDS = frozenset(
    [
        "abstract",
        "as",
        "async",
        "await",
        "become",
        "box",
        "break",
        "const",
        "continue",
        "crate",
        "do",
        "dyn",
        "else",
        "enum",
        "extern",
        "false",
        "final",
        "fn",
        "for",
        "if",
        "impl",
        "in",
        "let",
        "loop",
        "macro",
        "match",
        "mod",
        "move",
        "mut",
        "override",
        "priv",
        "pub",
        "ref",
        "return",
        "self",
        "static",
        "struct",
        "super",
        "trait",
        "true",
        "try",
        "type",
        "typeof",
        "unsafe",
        "unsized",
        "use",
        "virtual",
        "where",
        "while",
        "yield",
    ]
)


def write_rust(resources: list[ResourceInfo], url: str) -> str:
    """Generate the file of a module `rcp`."""
    types = Types()
    for word in _RESERVED:
        types.take_name(word)
    rows = [row for one in groups(resources).items() for row in _rows(types, *one)]
    text = [
        runtime("rust", "head.rs").replace("URL", one_line(url)),
        *(_record(record, types.records) for record in types.records.values()),
        "\n".join(rows),
        runtime("rust", *_PARTS),
    ]
    return "\n\n".join(part.strip("\n") for part in text) + "\n"


def _rows(types: Types, owner: str, members: list[tuple[str, ResourceInfo]]) -> Iterator[str]:
    for short, resource in members:
        schemas = resource.schemas
        value = schemas.get("value") or schemas.get("output")
        sent = _text(types.shape(value, inward=False)) if value else "Json"
        taken = _text(types.shape(value, inward=True)) if value else "Json"
        reads = bool({"read", "subscribe"} & set(resource.operations))
        writes = "write" in resource.operations
        at = f"{{ path: {_literal(resource.path)}, of: PhantomData }}"
        if "execute" in resource.operations:
            given = _text(types.shape(schemas.get("input"), inward=True))
            made = _text(types.shape(schemas.get("output"), inward=False))
            type_, code = f"Command<{given}, {made}>", f"Command {at}"
        elif reads and writes:
            type_ = f"Setting<{sent}, {taken}>"
            code = f"Setting {{ get: Readable {at}, set: Writable {at} }}"
        elif writes:
            type_, code = f"Writable<{taken}>", f"Writable {at}"
        elif reads:
            type_, code = f"Readable<{sent}>", f"Readable {at}"
        else:
            continue
        if resource.description:
            yield f"/// {one_line(resource.description)}"
        name = types.take_name(class_name(f"{owner}_{short}"))
        yield f"pub const {name}: {type_} = {code};"


def _literal(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _text(shape: Shape) -> str:
    match shape.kind:
        case "literal":
            kinds = {type(value) for value in shape.values}
            return _LITERALS.get(kinds.pop(), "Json") if len(kinds) == 1 else "Json"
        case "list":
            return f"Vec<{_text(shape.parts[0])}>"
        case "map":
            return f"BTreeMap<String, {_text(shape.parts[0])}>"
        case "union":
            held = [part for part in shape.parts if part.kind != "null"]
            return _optional(_text(held[0])) if len(held) == 1 else "Json"
        case "name":
            return shape.name
        case kind:
            return _WORDS[kind]


def _optional(text: str) -> str:
    return text if text == "Json" or text.startswith("Option<") else f"Option<{text}>"


def _record(record: Record, records: dict[str, Record]) -> str:
    lines = [f"/// {record.note}"] if record.note else []
    lines += ["#[derive(Clone, Debug, Default, PartialEq)]", f"pub struct {record.name} {{"]
    written, read = list[str](), list[str]()
    taken = set[str]()
    for field in record.fields:
        name = _identifier(field.name)
        while name in taken:
            name += "_"
        taken.add(name)
        text = _text(field.shape)
        if record.name in _held(field.shape, records):
            text = f"Option<Box<{text}>>"
        elif field.optional:
            text = _optional(text)
        if field.note:
            lines.append(f"    /// {field.note}")
        lines.append(f"    pub {name}: {text},")
        key = _literal(field.name)
        insert = f"map.insert({key}.into(), self.{name}.to_json());"
        if field.optional:
            insert = f"if self.{name}.to_json() != Json::Null {{ {insert} }}"
        written.append(f"        {insert}")
        read.append(f"            {name}: Value::from_json(json.get({key}))?,")
    mutable = "mut " if written else ""
    lines += [
        "}",
        "",
        f"impl Value for {record.name} {{",
        "    fn to_json(&self) -> Json {",
        f"        let {mutable}map = BTreeMap::new();",
        *written,
        "        Json::Map(map)",
        "    }",
        f"    fn from_json({'json' if read else '_'}: &Json) -> Result<Self, Error> {{",
        f"        Ok({record.name} {{",
        *read,
        "        })",
        "    }",
        "}",
    ]
    return "\n".join(lines)


def _identifier(text: str) -> str:
    name = re.sub(r"\W", "_", text, flags=re.ASCII) or "_"
    name = f"_{name}" if name[0].isdigit() or not name.strip("_") else name
    return f"{name}_" if name in _KEYWORDS else name


def _held(shape: Shape, records: dict[str, Record]) -> set[str]:
    """Return the records that a value of this shape holds by value."""
    waiting, seen = [shape], set[str]()
    while waiting:
        one = waiting.pop()
        if one.kind == "union":
            waiting += one.parts
        elif one.kind == "name" and one.name not in seen:
            seen.add(one.name)
            waiting += [field.shape for field in records[one.name].fields]
    return seen
