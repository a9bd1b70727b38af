"""The four bytes of a parameter: a float with the value, or the bits of an integer."""

from __future__ import annotations

import math
import struct
from typing import Any

__all__ = ["REAL", "bounds", "decoded", "param_set", "stored"]

REAL = 9
_CODES = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i"}
_FLOAT = struct.Struct("<f")


def bounds(type_: int) -> tuple[int, int] | None:
    """Return the limits of an integer type; None for a real number."""
    code = _CODES.get(type_)
    if code is None:
        return None
    bits = 8 * struct.calcsize(code)
    return (0, 2**bits - 1) if code.isupper() else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def decoded(raw: bytes, type_: int, *, bytewise: bool) -> float:
    """Return the value of four bytes."""
    code = _CODES.get(type_)
    if code is not None and bytewise:
        return float(struct.unpack_from(f"<{code}", raw)[0])
    (value,) = _FLOAT.unpack(raw)
    return float(round(value)) if code is not None and math.isfinite(value) else value


def encoded(value: float, type_: int, *, bytewise: bool) -> bytes:
    """Return the four bytes of a value."""
    code = _CODES.get(type_)
    if code is None:
        return _FLOAT.pack(value)
    if bytewise:
        return struct.pack(f"<{code}", round(value)).ljust(4, b"\0")
    return _FLOAT.pack(round(value))


def stored(value: float, type_: int, *, bytewise: bool) -> float:
    """Return what a vehicle keeps of a value within the bounds of its type."""
    return decoded(encoded(value, type_, bytewise=bytewise), type_, bytewise=bytewise)


def param_set(
    module: Any, to: tuple[int, int], name: str, value: float, type_: int, *, bytewise: bool
) -> tuple[Any, float]:
    """Build PARAM_SET; return it with the value that the vehicle will store.

    The bytes are inserted as they are: as floats, some integers would be signalling NaNs, whose
    bits do not survive.
    """
    raw = encoded(value, type_, bytewise=bytewise)
    message = module.MAVLink_param_set_message(*to, name.encode(), 0.0, type_)
    pack = message.unpacker.pack

    class Unpacker:
        @staticmethod
        def pack(_value: float, *rest: Any) -> bytes:
            return raw + pack(0.0, *rest)[4:]

    message.unpacker = Unpacker
    return message, decoded(raw, type_, bytewise=bytewise)
