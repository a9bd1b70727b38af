"""Encoding of typed values to CDR, for types without compiled code."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from rcp_ros2.idl import WIDTHS, Primitive, Ref, Sequence, Text, Type, fields_of
from rcp_ros2.types import is_bytes

__all__ = ["writer"]

_HEADER = b"\x00\x01\x00\x00"  # XCDR version 1, little endian
Put = Callable[[bytearray, Any], None]


def writer(cls: Any) -> Callable[[Any], bytes]:
    """Return a function that encodes the typed value of a message class."""
    put = _struct(cls)

    def write(value: Any) -> bytes:
        out = bytearray()  # alignment counts from the end of the header
        put(out, value)
        return _HEADER + bytes(out)

    return write


@lru_cache(maxsize=4096)
def _struct(cls: Any) -> Put:
    steps = [(field.name, _putter(field.type)) for field in fields_of(cls)]

    def put(out: bytearray, value: Any) -> None:
        for name, step in steps:
            step(out, getattr(value, name))
        if not steps:
            out.append(0)  # C forbids empty structs

    return put


def _putter(type_: Type) -> Put:
    match type_:
        case Primitive("octet"):
            return _octet
        case Primitive(name):
            return _number(name)
        case Text(_, wide):
            return _wide if wide else _text
        case Ref(cls):
            return _struct(cls)
        case Sequence(item, size, _):
            return _many(item, fixed=size is not None)


def _number(name: str) -> Put:
    letter, width = WIDTHS[name]
    pack = _pack_float if name == "float32" else struct.Struct("<" + letter).pack

    def put(out: bytearray, value: Any) -> None:
        out.extend(bytes(-len(out) % width))
        out.extend(pack(value))

    return put


def _pack_float(value: float) -> bytes:
    try:
        return struct.pack("<f", value)
    except OverflowError:  # where infinity is allowed, as in C
        return struct.pack("<f", math.copysign(math.inf, value))


_length = _number("uint32")


def _octet(out: bytearray, value: Any) -> None:
    out.append(value if isinstance(value, int) else value[0])  # rclpy's messages have one byte


def _text(out: bytearray, value: str) -> None:
    data = value.replace("\0", "").encode("utf-8", "replace") + b"\0"
    _length(out, len(data))
    out.extend(data)


def _wide(out: bytearray, value: str) -> None:
    data = value.encode("utf-16-le", "replace")
    units = struct.unpack(f"<{len(data) // 2}H", data)
    _length(out, len(units))
    out.extend(struct.pack(f"<{len(units)}I", *units))  # each stored in four bytes


def _many(item: Type, *, fixed: bool) -> Put:
    one = _putter(item)
    raw = is_bytes(item)

    def put(out: bytearray, value: Any) -> None:
        if not fixed:
            _length(out, len(value))
        if raw and not isinstance(value, list):
            out.extend(value)
        else:
            for each in value:
                one(out, each)

    return put
