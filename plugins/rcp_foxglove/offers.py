"""What a resource is for a viewer: a channel, a service, a parameter, a topic to publish on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec

from rcp_foxglove.renderings import Tail, as_json, as_serialised, as_well_known, replayed
from rcp_foxglove_types import well_known
from rcp_kernel.model import NativeType

__all__ = ["Channel", "Facts", "ParameterOffer", "Service", "Target", "channel_of", "service_of"]

Facts = dict[str, Any]
Numbered = Callable[[tuple[str, ...]], int]
"""Returns the number of a channel or service: the same one for the same facts."""


class Channel(NamedTuple):
    """A topic that clients may subscribe to."""

    id: int
    topic: str
    path: str
    tail: Tail
    native: bool
    advert: bytes
    """The channel in `advertise`."""


class Service(NamedTuple):
    """A service that clients may call."""

    id: int
    name: str
    path: str
    backend: str
    natives: Mapping[str, NativeType]
    advert: bytes
    """The service in `advertiseServices`."""


class Target(NamedTuple):
    """A topic that clients may publish on."""

    topic: str
    path: str
    backend: str
    native: NativeType | None
    deadman: bool
    valid_for: float | None
    """Validity of a message, in seconds, unless the configuration says otherwise."""


class ParameterOffer(NamedTuple):
    """A parameter that clients may read."""

    name: str
    path: str
    mark: str | None
    """The mark of its type, where JSON alone does not say it."""
    writable: bool


def channel_of(one: Facts, topic: str, native: NativeType | None, number: Numbered) -> Channel:
    """Return the channel of a resource: of its serialised form, if there is one."""
    tail: Tail = as_json
    if native is not None:
        encoding, name, language = native.encoding, native.name, native.schema_encoding
        schema, tail = native.schema, as_serialised
    else:
        encoding, language = "json", "jsonschema"
        published = one["schemas"]["value"]
        known = well_known(published)
        if known is None:
            name, schema = _title(one, "value"), _text(_as_object(published))
        else:
            name, schema, tail = known.name, _text(known.schema), as_well_known(known.convert)
    if one.get("meta", {}).get("replayed"):
        tail = replayed(tail)
    id_ = number((topic, one["path"], encoding, name, schema))
    facts = {
        "id": id_,
        "topic": topic,
        "encoding": encoding,
        "schemaName": name,
        "schema": schema,
        "schemaEncoding": language,
        "metadata": {"path": one["path"], "backend": one["backend"]},
    }
    advert = msgspec.json.encode(facts)
    return Channel(id_, topic, one["path"], tail, native is not None, advert)


def service_of(
    one: Facts, name: str, natives: Mapping[str, NativeType], number: Numbered
) -> Service:
    """Return the service of a service or action."""
    type_ = one.get("meta", {}).get("type") or _title(one, "input")
    request, response = _part(one, "input", natives), _part(one, "output", natives)
    id_ = number((name, one["path"], type_, request["schema"], response["schema"]))
    facts = {
        "id": id_,
        "name": name,
        "type": type_,
        "request": request,
        "response": response,
        "requestSchema": request["schema"],
        "responseSchema": response["schema"],
    }
    return Service(id_, name, one["path"], one["backend"], natives, msgspec.json.encode(facts))


def _part(one: Facts, part: str, natives: Mapping[str, NativeType]) -> dict[str, str]:
    native = natives.get(part)
    if native is not None:
        return {
            "encoding": native.encoding,
            "schemaName": native.name,
            "schemaEncoding": native.schema_encoding,
            "schema": native.schema,
        }
    return {
        "encoding": "json",
        "schemaName": _title(one, part),
        "schemaEncoding": "jsonschema",
        "schema": _text(_as_object(one["schemas"].get(part, {"type": "null"}))),
    }


def _title(one: Facts, part: str) -> str:
    """Return a name for a schema: the title of its type, or what the resource is called."""
    schema = one["schemas"].get(part, {})
    named = schema.get("title") or schema.get("$ref", "").rpartition("/")[2]
    return f"rcp.{named or one['path'].rpartition('/')[2]}"


def _as_object(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a schema whose root has its properties: viewers look there, not behind a `$ref`."""
    named = schema.get("$ref", "")
    if not named.startswith("#/$defs/"):
        return schema
    found = schema.get("$defs", {}).get(named.removeprefix("#/$defs/"), {})
    return {**{key: item for key, item in schema.items() if key != "$ref"}, **found}


def _text(schema: dict[str, Any]) -> str:
    return msgspec.json.encode(schema).decode()
