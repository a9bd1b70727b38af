"""The defaults of an ArduPilot's parameters, from the file that it generates: `@PARAM/param.pck`."""

from __future__ import annotations

import struct
from typing import Annotated

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceRejected, NotImplementedByRobot
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.files import Files, Verb

__all__ = ["ParameterDefaults", "unpacked"]

_PATH = "@PARAM/param.pck?withdefaults=1"
_MOST = 4 << 20  # bytes: ArduPilot reports 1 MiB, whatever the file has
_HEAD = struct.Struct("<HHH")  # magic, parameters in the file, parameters of the vehicle
_ENTRY = struct.Struct("<BB")
_WITH_DEFAULTS, _WITHOUT = 0x671C, 0x671B
_FORMATS = {1: "b", 2: "h", 3: "i", 4: "f"}
_HAS_DEFAULT = 1

Number = Annotated[float, Meta(extra_json_schema={"unit": "1"})]


class Defaults(Struct, frozen=True):
    """The defaults of the vehicle's firmware and board."""

    values: dict[str, Number]
    """By the names of the parameters."""


def unpacked(data: bytes) -> dict[str, float] | None:
    """Return the default of each parameter of a packed file; None: it has none.

    :raises ValueError: it is no such file, or is cut off.
    """
    try:
        return _unpacked(data)
    except (struct.error, UnicodeDecodeError, KeyError) as error:
        raise ValueError(f"param.pck cannot be read: {error}") from error


def _unpacked(data: bytes) -> dict[str, float] | None:
    magic, count, _ = _HEAD.unpack_from(data)
    if magic == _WITHOUT:
        return None
    if magic != _WITH_DEFAULTS:
        raise ValueError(f"param.pck begins with {magic:#06x}")
    found: dict[str, float] = {}
    at, name = _HEAD.size, b""
    while len(found) < count:
        while data[at : at + 1] == b"\0":  # so that no entry lies across the end of a block
            at += 1
        kind, lengths = _ENTRY.unpack_from(data, at)
        at += _ENTRY.size
        common, own = lengths & 15, (lengths >> 4) + 1
        name = name[:common] + data[at : at + own]
        value = struct.Struct("<" + _FORMATS[kind & 15])
        at += own
        # Where it is not in the file, it is the value.
        told = at + value.size if kind >> 4 & _HAS_DEFAULT else at
        (found[name.decode("ascii")],) = value.unpack_from(data, told)
        at = told + value.size
    return found


class ParameterDefaults:
    """Defaults as a service."""

    def __init__(self, files: Files) -> None:
        self._files = files

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="service/param/defaults", meta=READS, description="Read the defaults of the firmware and board for all parameters.", output=Defaults, timeout=120),
        ]  # fmt: skip

    def verbs(self) -> dict[str, Verb]:
        """Return the handler of each path."""
        return {"service/param/defaults": self.read}

    async def read(self, _: None, __: Progress) -> Defaults:
        """Read them from the vehicle.

        :raises NotImplementedByRobot: its firmware does not tell them.
        :raises DeviceRejected: it sends something else.
        """
        try:
            found = unpacked(await self._files.fetch(_PATH, _MOST))
        except ValueError as error:
            raise DeviceRejected(f"param/defaults: {error}") from error
        if found is None:
            raise NotImplementedByRobot(
                "param/defaults: this firmware does not tell its defaults",
                remedy="Update the firmware: recent versions of ArduPilot tell them.",
            )
        return Defaults(found)
