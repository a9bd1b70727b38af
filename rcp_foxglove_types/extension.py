"""Values with the fields of a well-known type beside their own: what panels draw loses nothing.

Most fields are the same in both, such as the bytes of an image, and are there once.
"""

from __future__ import annotations

import re
from typing import Any

import msgspec

from rcp_foxglove_types.plain_fields import with_fields
from rcp_foxglove_types.well_known import WellKnown, fields_of, well_known
from rcp_protocol.clock import iso

__all__ = ["Extension", "extension", "own_part"]

_TIMESTAMP = re.compile(rb'"timestamp":(?:null|"[^"]*"),?')
_KEY = b'"timestamp":'
_MERGED = frozenset(("timestamp", "frame_id", "fields"))
"""Fields that both may have with other contents; all others are one type's only, or the same."""
_SECOND = 1_000_000_000


class Extension:
    """Adds what a well-known type has to values of one schema."""

    def __init__(self, known: WellKnown, schema: dict[str, Any]) -> None:
        self.name = known.name
        self._convert = known.convert
        self._same = known.same
        self._own = fields_of(schema)
        properties = _properties(schema)
        merged = {**known.schema, "properties": {**properties, **known.schema["properties"]}}
        if "$defs" in schema:
            merged["$defs"] = schema["$defs"]
        self.schema = msgspec.json.encode(merged)
        """JSON Schema of what `encode` returns."""

    def encode(self, value: Any, body: bytes, sampled: int) -> bytes:
        """Return a value's JSON `body` with the other fields; as it is, if a part is missing."""
        value = with_fields(value)
        try:
            made = self._convert(_Light(value), sampled)
        except (AttributeError, TypeError, ValueError):
            return body
        more = {key: item for key, item in made.items() if key not in self._same}
        if "frame_id" in self._own and getattr(value, "frame_id", None):
            more.pop("frame_id", None)
        clash = self._own & more.keys()
        if not clash or (clash == {"timestamp"} and body.count(_KEY) == 1):
            head = _TIMESTAMP.sub(b"", body, count=1) if clash else body
            return b",".join((head[:-1].rstrip(b","), msgspec.json.encode(more)[1:]))
        whole = msgspec.json.decode(body)
        if "fields" in clash:
            more["fields"] = [
                own | other for own, other in zip(whole["fields"], more["fields"], strict=True)
            ]
        return msgspec.json.encode(whole | more)


class _Light:
    """A value without its long bytes, which would be encoded only to be left out."""

    def __init__(self, value: Any) -> None:
        self._value = value

    def __getattr__(self, name: str) -> Any:
        return b"" if name == "data" else getattr(self._value, name)


def extension(schema: dict[str, Any]) -> Extension | None:
    """Return what makes values of a schema well-known; None: nothing that loses nothing."""
    known = well_known(schema)
    if known is None:
        return None
    both = known.schema["properties"].keys() & fields_of(schema)
    return Extension(known, schema) if both <= known.same | _MERGED else None


def own_part(message: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    """Return the value that was extended; `schema` is its own."""
    names = fields_of(schema)
    value = {key: item for key, item in message.items() if key in names}
    stamp = value.get("timestamp")
    if isinstance(stamp, dict):
        value["timestamp"] = iso(stamp["sec"] * _SECOND + stamp["nsec"])  # pyright: ignore[reportUnknownArgumentType]
    if isinstance(value.get("fields"), list):
        value["fields"] = [
            {key: item for key, item in one.items() if key != "type"} for one in value["fields"]
        ]
    return value


def _properties(schema: dict[str, Any]) -> dict[str, Any]:
    named = schema.get("$ref", "")
    if named.startswith("#/$defs/"):
        return _properties(schema["$defs"][named.removeprefix("#/$defs/")])
    return schema.get("properties", {})
