"""CDR: the bytes of a message as ROS 2 has them (XCDR version 1, little-endian)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from rcp_ros_messages.message_type import Field, full_name, message_type

__all__ = ["encode_cdr"]

_HEADER = b"\x00\x01\x00\x00"
_FORMATS = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_BYTES = ("uint8", "byte", "char")
Writer = Callable[[bytearray, Any], None]


def encode_cdr(type_: str, message: dict[str, Any]) -> bytes:
    """Encode a message of a common type.

    :raises KeyError: the type is not one of them, or a field is missing.
    """
    out = bytearray()
    _message_writer(full_name(type_))(out, message)
    return _HEADER + bytes(out)


@lru_cache(maxsize=256)
def _message_writer(name: str) -> Writer:
    type_ = message_type(name)
    if type_ is None:
        raise KeyError(name)
    writers = [(field.name, _field_writer(field)) for field in type_.fields]

    def write(out: bytearray, message: Any) -> None:
        if not writers:  # an empty message has one byte
            out.append(0)
        for field, writer in writers:
            writer(out, message[field])

    return write


def _field_writer(field: Field) -> Writer:
    if field.length is not None and field.type in _FORMATS:
        return _numbers_writer(field.type, field.length)
    one = _single_writer(field.type)
    if field.length is None:
        return one
    counted = field.length == 0

    def write(out: bytearray, values: Any) -> None:
        if counted:
            _count(out, len(values))
        for value in values:
            one(out, value)

    return write


def _single_writer(type_: str) -> Writer:
    if type_ == "string":
        return _text
    if type_ not in _FORMATS:
        return _message_writer(type_)
    pack = struct.Struct("<" + _FORMATS[type_])

    def write(out: bytearray, value: Any) -> None:
        _align(out, pack.size)
        out += pack.pack(value)

    return write


def _numbers_writer(type_: str, length: int) -> Writer:
    code, size = _FORMATS[type_], struct.calcsize(_FORMATS[type_])

    def write(out: bytearray, values: Any) -> None:
        if not length:
            _count(out, len(values))
        if type_ in _BYTES and isinstance(values, bytes):
            out.extend(values)
        elif len(values):
            _align(out, size)
            out.extend(struct.pack(f"<{len(values)}{code}", *values))

    return write


def _align(out: bytearray, size: int) -> None:
    out.extend(bytes(-len(out) % size))


def _count(out: bytearray, count: int) -> None:
    _align(out, 4)
    out += struct.pack("<I", count)


def _text(out: bytearray, value: str) -> None:
    data = value.encode()
    _count(out, len(data) + 1)
    out += data
    out.append(0)
