"""Python output: a TypedDict per type, a class per tenant, a method per operation."""

from __future__ import annotations

from rcp_client.codegen.types import Field, Record, Shape, Types, class_name, groups, one_line
from rcp_client.messages import ResourceInfo

__all__ = ["write_python"]

_WORDS = {
    "any": "Any",
    "null": "None",
    "bool": "bool",
    "int": "int",
    "long": "int",
    "ulong": "int",
    "float": "float",
    "str": "str",
    "bytes": "bytes",
}
_RESERVED = (
    "Any", "AsyncGenerator", "Callable", "Client", "CommandHandle", "Feedback", "Literal",
    "NotRequired", "TypedDict", "cast",
)  # fmt: skip


def write_python(resources: list[ResourceInfo], url: str) -> str:
    """Generate the module."""
    types = Types()
    for word in _RESERVED:
        types.take_name(word)
    classes: list[str] = []
    first = ""
    for owner, members in groups(resources).items():
        name = types.take_name(class_name(owner))
        first = first or name
        classes.append(_class(name, owner, members, types))
    records = [_record(record) for record in types.records.values()]
    return "\n\n\n".join([_head(url, first), *records, *classes]) + "\n"


def _head(url: str, name: str) -> str:
    return f'''\
"""Typed client of the gateway at {one_line(url)}, written by `rcpctl codegen --lang python`.

    async with rcp_client.connect() as client:
        robot = {name}(client)

Values are plain dictionaries; `…In` is what may be sent, with fields that may be left out.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable
from typing import Any, Literal, NotRequired, TypedDict, cast

from rcp_client import Client, CommandHandle, Feedback'''


def _text(shape: Shape) -> str:
    match shape.kind:
        case "literal":
            return f"Literal[{', '.join(map(repr, shape.values))}]"
        case "list":
            return f"list[{_text(shape.parts[0])}]"
        case "map":
            return f"dict[str, {_text(shape.parts[0])}]"
        case "union":
            return " | ".join(map(_text, shape.parts))
        case "name":
            return shape.name
        case kind:
            return _WORDS[kind]


def _record(record: Record) -> str:
    if not all(_is_name(field.name) for field in record.fields):
        return _functional(record)
    lines = [f"class {record.name}(TypedDict):", f'    """{_doc(record.note or record.name)}"""']
    if record.fields:
        lines.append("")
    for field in record.fields:
        note = f"  # {field.note}" if field.note else ""
        lines.append(f"    {field.name}: {_field(field)}{note}")
    return "\n".join(lines)


def _functional(record: Record) -> str:
    """Generate a record with field names that are not Python identifiers."""
    fields = ", ".join(f"{field.name!r}: {_field(field)!r}" for field in record.fields)
    return f"{record.name} = TypedDict({record.name!r}, {{{fields}}})"


def _field(field: Field) -> str:
    return f"NotRequired[{_text(field.shape)}]" if field.optional else _text(field.shape)


def _is_name(text: str) -> bool:
    import keyword

    return text.isidentifier() and not keyword.iskeyword(text) and not text.startswith("__")


def _doc(text: str) -> str:
    plain = one_line(text)
    return plain + " " if plain.endswith('"') else plain


def _class(name: str, owner: str, members: list[tuple[str, ResourceInfo]], types: Types) -> str:
    what = "The gateway itself." if owner == "system" else f"What the tenant '{owner}' has."
    lines = [
        f"class {name}:",
        f'    """{what}"""',
        "",
        "    def __init__(self, client: Client) -> None:",
        "        self.client = client",
    ]
    for short, resource in members:
        for method in _methods(short, resource, types):
            lines += ["", *("    " + line if line else "" for line in method)]
    return "\n".join(lines)


def _methods(short: str, resource: ResourceInfo, types: Types) -> list[list[str]]:
    made: list[list[str]] = []
    schemas, path, about = resource.schemas, repr(resource.path), _doc(resource.description)
    value = schemas.get("value") or schemas.get("output")
    out = _text(types.shape(value, inward=False)) if value else "Any"
    if "read" in resource.operations:
        made.append([
            f"async def read_{short}(self, *, fresh: bool = False) -> {out}:",
            f'    """Read: {about}"""',
            f"    return cast({out!r}, await self.client.read({path}, fresh=fresh))",
        ])  # fmt: skip
    if "subscribe" in resource.operations:
        made.append([
            f"async def watch_{short}(self, **options: Any) -> AsyncGenerator[{out}, None]:",
            f'    """Watch: {about}"""',
            f"    async for update in self.client.subscribe({path}, **options):",
            f"        yield cast({out!r}, update.body)",
        ])  # fmt: skip
    if "write" in resource.operations:
        taken = _text(types.shape(value, inward=True))
        made.append([
            f"async def write_{short}(",
            f"    self, value: {taken}, *, valid_for: float | None = None, dry_run: bool = False",
            f") -> {out}:",
            f'    """Write: {about}"""',
            "    done = await self.client.write(",
            f"        {path}, value, valid_for=valid_for, dry_run=dry_run",
            "    )",
            f"    return cast({out!r}, done)",
        ])  # fmt: skip
    if "execute" in resource.operations:
        made += _execute(short, resource, types)
    return made


def _execute(short: str, resource: ResourceInfo, types: Types) -> list[list[str]]:
    schemas, path, about = resource.schemas, repr(resource.path), _doc(resource.description)
    out = _text(types.shape(schemas.get("output"), inward=False))
    shape = types.shape(schemas.get("input"), inward=True)
    taken = _text(shape)
    may_lack = shape.kind == "null" or any(part.kind == "null" for part in shape.parts)
    given = f"input: {taken}" + (" = None" if may_lack else "")
    return [
        [
            f"async def execute_{short}(",
            f"    self, {given}, *, deadline: float | None = None,",
            "    on_feedback: Callable[[Feedback], None] | None = None,",
            f") -> {out}:",
            f'    """Carry out: {about}"""',
            "    done = await self.client.execute(",
            f"        {path}, input, deadline=deadline, on_feedback=on_feedback",
            "    )",
            f"    return cast({out!r}, done)",
        ],
        [
            f"async def start_{short}(",
            f"    self, {given}, *, deadline: float | None = None",
            ") -> CommandHandle:",
            f'    """Start: {about}"""',
            f"    return await self.client.start({path}, input, deadline=deadline)",
        ],
    ]
