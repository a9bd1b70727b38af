"""CBOR as rosbridge has it: arrays of numbers are typed arrays, little-endian."""

from __future__ import annotations

import struct
from typing import Any

import cbor2

from rcp_ros_messages import MessageType, message_type

__all__ = ["cbor_head", "to_cbor"]

_TYPED = {
    "uint16": (69, "H"),
    "uint32": (70, "I"),
    "uint64": (71, "Q"),
    "int8": (72, "b"),
    "int16": (77, "h"),
    "int32": (78, "i"),
    "int64": (79, "q"),
    "float32": (85, "f"),
    "float64": (86, "d"),
}
"""Tags of RFC 8746, and the format of an element."""


def cbor_head(topic: str) -> bytes:
    """Return the start of a message with the operation `publish`, up to the value of `msg`."""
    fields = b"".join(map(cbor2.dumps, ("op", "publish", "topic", topic, "msg")))
    return b"\xa3" + fields


def to_cbor(value: Any, type_: str) -> bytes:
    """Encode a message, of a common type or of any other."""
    known = message_type(type_)
    return cbor2.dumps(_untyped(value) if known is None else _typed(value, known))


def _typed(value: dict[str, Any], type_: MessageType) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for field in type_.fields:
        item = value[field.name]
        inner = message_type(field.type)
        if field.length is not None and field.type in _TYPED:
            out[field.name] = _array(item, *_TYPED[field.type])
        elif inner is None:
            out[field.name] = item
        elif field.length is None:
            out[field.name] = _typed(item, inner)
        else:
            out[field.name] = [_typed(one, inner) for one in item]
    return out


def _array(values: Any, tag: int, code: str) -> cbor2.CBORTag:
    return cbor2.CBORTag(tag, struct.pack(f"<{len(values)}{code}", *values))


def _untyped(value: Any) -> Any:
    """Return a value whose lists of floats are typed arrays."""
    if isinstance(value, dict):
        return {key: _untyped(item) for key, item in value.items()}  # pyright: ignore[reportUnknownVariableType]
    if isinstance(value, list):
        if value and all(type(item) is float for item in value):  # pyright: ignore[reportUnknownVariableType]
            return _array(value, *_TYPED["float64"])
        return [_untyped(item) for item in value]  # pyright: ignore[reportUnknownVariableType]
    return value
