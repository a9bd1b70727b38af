"""Messages as values of the tree: plain data, as JSON has it."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import msgspec
from mcap.exceptions import McapError

from rcp_foxglove_types import own_part
from rcp_recordings.names import SAMPLE, VALUE_SCHEMA
from rcp_recordings.reading import Track

__all__ = ["decoder", "ros_decoder", "schema_of"]

Decode = Callable[[bytes], Any]


def schema_of(track: Track) -> dict[str, Any]:
    """Return the JSON Schema of a channel's values."""
    text = track.facts.get(VALUE_SCHEMA)
    if text is None and track.schema is not None and track.schema.encoding == "jsonschema":
        return msgspec.json.decode(track.schema.data)
    return {} if text is None else msgspec.json.decode(text)


def decoder(track: Track) -> Decode:
    """Return what makes values of a channel's messages."""
    if track.channel.message_encoding == "cdr" and track.schema is not None:
        return ros_decoder(track.schema.name, track.schema.data.decode())
    if track.channel.metadata.get("kind") == SAMPLE and VALUE_SCHEMA in track.facts:
        schema = schema_of(track)
        return lambda data: own_part(msgspec.json.decode(data), schema)
    return msgspec.json.decode


@lru_cache(maxsize=512)
def ros_decoder(name: str, definition: str) -> Decode:
    """Return what decodes the CDR of a ROS message."""
    from mcap_ros2._dynamic import generate_dynamic

    decode = generate_dynamic(name, definition)[name]

    def decoded(data: bytes) -> Any:
        try:
            return _plain(decode(data))
        except (McapError, ValueError, IndexError, RuntimeError, NotImplementedError) as error:
            raise ValueError(f"not a {name}: {error}") from error

    return decoded


def _plain(value: Any) -> Any:
    """Return a message as data, with bytes and numbers that JSON does not have as the protocol has them."""
    if isinstance(value, float):
        return value if math.isfinite(value) else _NAMES[str(value)]
    if isinstance(value, (bytes, bytearray, memoryview)):
        return base64.b64encode(value).decode()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]  # pyright: ignore[reportUnknownVariableType]
    slots = getattr(type(value), "__slots__", None)
    if slots is not None and hasattr(value, "_type"):
        return {name: _plain(getattr(value, name)) for name in slots}
    return value


_NAMES = {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}
