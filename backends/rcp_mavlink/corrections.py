"""Corrections of satellite positions (RTK), passed on to the receiver on board."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import UnsupportedOperation
from rcp_kernel.model import Resource
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle

__all__ = ["CORRECTIONS", "Corrections", "pieces"]

CORRECTIONS = "actuator/gnss_corrections"
_PIECE, _PIECES = (
    180,
    4,
)  # bytes of data in a GPS_RTCM_DATA, and the most of them that are put together
_FRAGMENTED = 1


class Correction(Struct, frozen=True, forbid_unknown_fields=True):
    """One message of RTCM 3, as a base station or an NTRIP caster sends it."""

    data: Annotated[bytes, Meta(min_length=6, max_length=_PIECE * _PIECES)]


def pieces(data: bytes, sequence: int) -> Iterator[tuple[int, int, bytes]]:
    """Cut a message into flags, length and padded data of GPS_RTCM_DATA.

    A vehicle takes a message for whole at the first piece that is not full, or at the fourth: one whose
    length is a multiple of a piece ends with an empty one.
    """
    if len(data) < _PIECE:
        yield sequence << 3, len(data), data.ljust(_PIECE, b"\0")
        return
    count = min(_PIECES, len(data) // _PIECE + 1)
    for number in range(count):
        part = data[number * _PIECE : (number + 1) * _PIECE]
        yield sequence << 3 | number << 1 | _FRAGMENTED, len(part), part.ljust(_PIECE, b"\0")


class Corrections:
    """The receiver of one vehicle."""

    def __init__(self, hub: Hub, vehicle: Vehicle) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._sequence = 0

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name=CORRECTIONS, moves=False, description="Pass a message of RTCM 3 on to the GNSS receiver, for positions by RTK; sensor/gnss tells what the receiver makes of them.", value=Correction, examples=({"data": "0wAGPs0AAAAA"},), max_age=2.0),
        ]  # fmt: skip

    async def write(self, value: Correction) -> None:
        """Send a message in as many pieces as it needs.

        :raises UnsupportedOperation: the dialect of the configuration has no message for it.
        """
        make: Any = getattr(self._hub.dialect.module, "MAVLink_gps_rtcm_data_message", None)
        if make is None:
            raise UnsupportedOperation("the dialect has no GPS_RTCM_DATA")
        for flags, length, data in pieces(value.data, self._sequence):
            self._hub.send(self._vehicle, make(flags, length, list(data)))
        self._sequence = (self._sequence + 1) % 32
