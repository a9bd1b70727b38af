"""Channels of a recording as resources, and their messages as values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple, NewType

from msgspec import Meta

from rcp_kernel.errors import InvalidPath
from rcp_kernel.model import Kind, NativeType, Operation, Resource, kind_of
from rcp_recordings.names import DESCRIPTION, KIND, NATIVE, SAMPLE, TOPIC
from rcp_recordings.reading import Record, Track
from rcp_recordings.values import decoder, schema_of

__all__ = ["Played", "RosMessage", "played"]

_READ = Operation.READ | Operation.SUBSCRIBE


class RosMessage:
    """A message in CDR, decoded by whoever needs its value."""

    __slots__ = ("_decode", "data")

    def __init__(self, data: bytes, decode: Callable[[bytes], Any]) -> None:
        self.data = data
        self._decode = decode

    def decode(self) -> Any:
        """Return the value."""
        return self._decode(self.data)


class Played(NamedTuple):
    """A resource of a replay."""

    resource: Resource
    value: Callable[[Record], Any]


def played(track: Track) -> Played | None:
    """Return the resource of a channel; None: it is played as a part of another one, or not ours."""
    kind = track.facts.get(KIND)
    name = _name(track.channel.topic)
    if kind is None or kind == NATIVE or name is None:
        return None
    if kind != SAMPLE:
        name = f"event/{name}"
    try:
        branch = kind_of(name)
    except InvalidPath:
        return None
    if branch in (Kind.ACTION, Kind.SERVICE):
        return None
    decode = decoder(track)
    is_ros = track.channel.message_encoding == "cdr"

    def value(record: Record) -> Any:
        return RosMessage(record.data, decode) if is_ros else decode(record.data)

    return Played(_resource(name, track, is_ros=is_ros), value)


def _name(topic: str) -> str | None:
    """Return the name of a topic below its tenant."""
    parts = topic.split("/", 3)
    return parts[3] if len(parts) == 4 and parts[1] == "tenant" else None


def _resource(name: str, track: Track, *, is_ros: bool) -> Resource:
    schema = track.schema
    told = track.facts.get(DESCRIPTION) or f"{track.facts[KIND].capitalize()}s that were recorded."
    meta: dict[str, Any] = {"replayed": True}
    native: dict[str, NativeType] = {}
    if is_ros and schema is not None:
        native["value"] = NativeType(
            name=schema.name,
            encoding="cdr",
            schema_encoding=schema.encoding,
            schema=schema.data.decode(),
        )
        if TOPIC in track.facts:
            meta["topic"] = track.facts[TOPIC]
    return Resource(
        name=name,
        description=f"Replayed: {told}",
        value=_type(schema_of(track), name),
        operations=_READ,
        live=True,
        moves=False,
        native=schema.name if native and schema is not None else None,
        native_types=native,
        meta=meta,
    )


def _type(schema: dict[str, Any], name: str) -> Any:
    """Return a type that has a schema and takes anything: it was validated when it was recorded."""
    bare = {key: item for key, item in schema.items() if key != "$id"}
    id_ = schema.get("$id", "")
    title = id_.removeprefix("rcp:schema:").rpartition(".")[0] or name.rpartition("/")[2]
    make: Any = NewType  # hashable, and named in the schema's id, as `Annotated` is not
    return make(title, Annotated[Any, Meta(extra_json_schema=bare or {"type": "object"})])
