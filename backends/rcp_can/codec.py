"""Payload layouts as data: fields, units and their position in the bytes.

Numbers out of range are clamped, never wrapped: a set-point that is
too large by a bit must not become one the other way round. What is not a number is refused.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple, Protocol

__all__ = ["Codec", "Field", "Layout", "Packed", "Span", "clamp"]

_LIMITS = {
    "b": (-(2**7), 2**7 - 1),
    "B": (0, 2**8 - 1),
    "h": (-(2**15), 2**15 - 1),
    "H": (0, 2**16 - 1),
    "i": (-(2**31), 2**31 - 1),
    "I": (0, 2**32 - 1),
    "q": (-(2**63), 2**63 - 1),
    "Q": (0, 2**64 - 1),
}
_FLOAT = 3.4028234663852886e38  # the greatest 32-bit float


def clamp(value: float, low: float, high: float) -> float:
    """Return the nearest value within two bounds."""
    return low if value < low else min(value, high)


class Codec(Protocol):
    """Convert values by name to bytes and back."""

    size: int
    """Bytes of the payload."""
    names: tuple[str, ...]

    def encode(self, **values: float) -> bytes:
        """Return the payload; fields that are not given are 0.

        :raises ValueError: a value is not a number, or the field is unknown.
        """
        ...

    def decode(self, data: bytes | bytearray) -> dict[str, float]:
        """Return the fields; extra bytes are ignored.

        :raises ValueError: the payload is too short, or contains a value that is not a number.
        """
        ...


class Field(NamedTuple):
    """One number: its struct code and its resolution."""

    name: str
    code: str
    scale: float = 1.0
    nan: bool = False
    """Whether the float may be NaN, which then has a special meaning."""


class Layout:
    """Fields one after another, as `struct` packs them; the first argument is the byte order."""

    def __init__(self, order: str, *fields: Field) -> None:
        self.fields = fields
        self.names = tuple(field.name for field in self.fields if field.name)
        self._struct = struct.Struct(order + "".join(field.code for field in self.fields))
        self._named = tuple(field for field in self.fields if field.name)
        self.size = self._struct.size

    def encode(self, **values: float) -> bytes:
        """Return the payload; see `Codec`."""
        if extra := values.keys() - set(self.names):
            raise ValueError(f"no field {', '.join(sorted(extra))}")
        return self._struct.pack(*[_raw(f, values.get(f.name, 0)) for f in self._named])

    def decode(self, data: bytes | bytearray) -> dict[str, float]:
        """Return the fields; see `Codec`."""
        if len(data) < self.size:
            raise ValueError(f"{len(data)} bytes, expected {self.size}")
        found: dict[str, float] = {}
        for field, raw in zip(self._named, self._struct.unpack_from(data), strict=True):
            if field.code == "f" and not field.nan and not math.isfinite(raw):
                raise ValueError(f"{field.name} is {raw}")
            found[field.name] = raw if field.scale == 1.0 else raw * field.scale
        return found


def _raw(field: Field, value: float) -> float:
    if field.code in "fd":
        if math.isnan(value):
            if field.nan:
                return value
            raise ValueError(f"{field.name} is not a number")
        return clamp(value / field.scale, -_FLOAT, _FLOAT)
    if math.isnan(value):
        raise ValueError(f"{field.name} is not a number")
    low, high = _LIMITS[field.code]
    steps = value if field.scale == 1.0 else value / field.scale
    return int(
        clamp(steps if isinstance(steps, int) or math.isinf(steps) else round(steps), low, high)
    )


class Span(NamedTuple):
    """An unsigned number of some bits, scaled to a range if one is given."""

    name: str
    bits: int
    low: float | None = None
    high: float | None = None

    def nearest(self, value: float) -> float:
        """Return what a receiver decodes if a value of the range is sent."""
        mask = (1 << self.bits) - 1
        if self.low is None or self.high is None:
            return _code(value, None, mask, 0.0)
        low, width = self.low, self.high - self.low
        return low + _code(value, low, mask, width) * width / mask


def _code(value: float, low: float | None, mask: int, width: float) -> int:
    """Return the number that stands for a value in a field."""
    steps = value if low is None else (value - low) * mask / width
    return int(clamp(steps if math.isinf(steps) else round(steps), 0, mask))


class Packed:
    """Bit fields, most significant first, as in the MIT protocol and many sensors."""

    def __init__(self, *spans: Span) -> None:
        self.spans = spans
        self.names = tuple(span.name for span in self.spans)
        bits = sum(span.bits for span in self.spans)
        if bits % 8:
            raise ValueError(f"{bits} bits are not a whole number of bytes")
        self.size = bits // 8
        self._plan: list[tuple[str, int, int, float | None, float]] = []
        shift = bits
        for span in self.spans:
            shift -= span.bits
            mask = (1 << span.bits) - 1
            width = 0.0
            if span.low is not None and span.high is not None:
                width = span.high - span.low
            self._plan.append((span.name, shift, mask, span.low, width))

    def encode(self, **values: float) -> bytes:
        """Return the payload; see `Codec`. A field that is not given is 0, or its lower end."""
        if extra := values.keys() - set(self.names):
            raise ValueError(f"no field {', '.join(sorted(extra))}")
        word = 0
        for name, shift, mask, low, width in self._plan:
            value = values.get(name, 0)
            if math.isnan(value):
                raise ValueError(f"{name} is not a number")
            word |= _code(value, low, mask, width) << shift
        return word.to_bytes(self.size, "big")

    def decode(self, data: bytes | bytearray) -> dict[str, float]:
        """Return the fields; see `Codec`."""
        if len(data) < self.size:
            raise ValueError(f"{len(data)} bytes, expected {self.size}")
        word = int.from_bytes(data[: self.size], "big")
        found: dict[str, float] = {}
        for name, shift, mask, low, width in self._plan:
            raw = word >> shift & mask
            found[name] = raw if low is None else low + raw * width / mask
        return found
