"""Objects of a CANopen dictionary as typed values, and their bytes (CiA 301, 7.1)."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta

from rcp_kernel.errors import DeviceRejected
from rcp_kernel.types import UInt64, nonfinite

if TYPE_CHECKING:
    from canopen.objectdictionary import ODVariable

__all__ = ["Entry", "entry_of", "slug"]

_SIGNED = (0x02, 0x03, 0x10, 0x04, 0x12, 0x13, 0x14, 0x15)
_UNSIGNED = (0x05, 0x06, 0x16, 0x07, 0x18, 0x19, 0x1A, 0x1B)
_INTEGERS = {kind: (size, True) for size, kind in enumerate(_SIGNED, 1)} | {
    kind: (size, False) for size, kind in enumerate(_UNSIGNED, 1)
}
"""Number of bytes and signedness, by data type number of CiA 301."""
_BOOLEAN, _REAL32, _TEXT, _OCTETS, _REAL64 = 0x01, 0x08, 0x09, 0x0A, 0x11
_REALS = {_REAL32: "<f", _REAL64: "<d"}
_LONGEST = 1024  # bytes of a string
_INT64 = 2**63 - 1


@dataclass(frozen=True)
class Entry:
    """One object: address, type and access."""

    index: int
    sub: int
    kind: int
    """Number of the data type."""
    type: Any
    readable: bool
    writable: bool

    def pack(self, value: Any) -> bytes:
        """Encode a value, little-endian."""
        match self.kind:
            case _ if self.kind == _BOOLEAN:
                return bytes((value,))
            case _ if self.kind in _REALS:
                return struct.pack(_REALS[self.kind], value)
            case _ if self.kind == _TEXT:
                return value.encode("latin-1", "replace")
            case _ if self.kind == _OCTETS:
                return bytes(value)
            case _:
                size, signed = _INTEGERS[self.kind]
                return int(value).to_bytes(size, "little", signed=signed)

    def unpack(self, data: bytes) -> Any:
        """Decode a value.

        :raises DeviceRejected: there are too few bytes.
        """
        if self.kind == _TEXT:
            return data.rstrip(b"\0").decode("latin-1")
        if self.kind == _OCTETS:
            return data
        if len(data) < (size := self._size):
            raise DeviceRejected(
                f"0x{self.index:04X}:{self.sub:02X} has {len(data)} bytes, expected {size}",
                remedy="Check that the EDS belongs to this device.",
            )
        if self.kind == _BOOLEAN:
            return bool(data[0])
        if self.kind in _REALS:
            return struct.unpack(_REALS[self.kind], data[:size])[0]
        return int.from_bytes(data[:size], "little", signed=_INTEGERS[self.kind][1])

    @property
    def _size(self) -> int:
        if self.kind == _BOOLEAN:
            return 1
        if self.kind in _REALS:
            return struct.calcsize(_REALS[self.kind])
        return _INTEGERS[self.kind][0]


def entry_of(variable: ODVariable) -> Entry | None:
    """Return the entry of a variable; None for a domain or another object without a value."""
    type_ = _type(variable)
    access = variable.access_type or "rw"
    if type_ is None:
        return None
    readable, writable = access != "wo", access.startswith(("rw", "wo"))
    kind: Any = variable.data_type
    return Entry(variable.index, variable.subindex, kind, type_, readable, writable)


def _type(variable: ODVariable) -> Any:
    kind, unit = variable.data_type, variable.unit or "1"
    if kind == _BOOLEAN:
        return bool
    if kind in _REALS:
        return nonfinite(unit)
    if kind == _TEXT:
        return Annotated[str, Meta(max_length=_LONGEST)]
    if kind == _OCTETS:
        return Annotated[bytes, Meta(max_length=_LONGEST)]
    if kind not in _INTEGERS:
        return None
    size, signed = _INTEGERS[kind]
    low = -(1 << 8 * size - 1) if signed else 0
    high = low + (1 << 8 * size) - 1
    low = low if variable.min is None else max(low, int(variable.min))
    high = high if variable.max is None else min(high, int(variable.max))
    if high > _INT64:
        return UInt64
    return Annotated[int, Meta(ge=low, le=high, extra_json_schema={"unit": unit})]


def slug(text: str) -> str:
    """Convert an EDS name to a path segment."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_") or "object"
