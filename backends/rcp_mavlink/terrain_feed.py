"""Heights of the ground for a vehicle that asks for them (TERRAIN_REQUEST)."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from typing import Any

from rcp_mavlink.elevation import Elevation, tile_at
from rcp_mavlink.frames import Frame
from rcp_mavlink.geo import METRES_PER_DEGREE
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle

__all__ = ["TerrainFeed", "block"]

_BITS, _ACROSS = 56, 8  # blocks of a request: seven rows to the north, eight columns to the east
_SIDE = 4  # samples along the edge of a block
_PAUSE = 0.05  # s between two messages, which a slow radio bears
_MOST = 224  # blocks without heights, those of four grids


def block(
    height: Callable[[float, float], float | None], lat: float, lon: float, spacing: float, bit: int
) -> list[int] | None:
    """Return the heights of one block of a grid (deg, deg, m), from south to north and west to east.

    None if one of them is not known.
    """
    south, west = bit // _ACROSS * _SIDE, bit % _ACROSS * _SIDE
    found: list[int] = []
    for place in range(_SIDE * _SIDE):
        north, east = (south + place // _SIDE) * spacing, (west + place % _SIDE) * spacing
        value = height(*_displaced(lat, lon, north, east))
        if value is None:
            return None
        found.append(round(value))
    return found


def _displaced(lat: float, lon: float, north: float, east: float) -> tuple[float, float]:
    """Return a place at an offset, with the longitude scaled half way, as ArduPilot does."""
    turn = north / METRES_PER_DEGREE
    scale = max(0.01, math.cos(math.radians(lat + turn / 2)))
    return lat + turn, lon + east / METRES_PER_DEGREE / scale


class TerrainFeed:
    """What one vehicle is sent from the gateway's tiles; the latest request counts.

    `start` runs what nobody waits for.
    """

    def __init__(
        self,
        hub: Hub,
        vehicle: Vehicle,
        elevation: Elevation,
        start: Callable[[Coroutine[Any, Any, None]], None],
    ) -> None:
        self._hub, self._vehicle, self._elevation, self._start = hub, vehicle, elevation, start
        self._request: dict[str, Any] | None = None
        self._busy = False
        self._lacking: dict[tuple[int, int, int, int], set[str]] = {}
        """The latest blocks that are not whole, with their tiles."""

    @property
    def missing(self) -> list[str]:
        """The tiles that the vehicle needs and the folder does not have, or not whole."""
        return sorted(set[str]().union(*self._lacking.values()))

    def take(self, frame: Frame) -> None:
        """Take a request."""
        fields = frame.fields()
        if not fields["grid_spacing"] or abs(fields["lat"]) > 90e7 or abs(fields["lon"]) > 180e7:
            return
        self._request = fields
        if not self._busy:
            self._busy = True
            self._start(self._serve())

    async def _serve(self) -> None:
        """Send what was asked for, one block after the other, until all of the latest is sent."""
        try:
            while (request := self._request) is not None:
                bits = [bit for bit in range(_BITS) if request["mask"] >> bit & 1]
                for bit in bits:
                    if self._request is not request or self._vehicle.lost:
                        break
                    await self._send(request, bit)
                if self._request is request:
                    self._request = None
        finally:
            self._busy = False

    async def _send(self, request: dict[str, Any], bit: int) -> None:
        lat, lon, spacing = request["lat"], request["lon"], request["grid_spacing"]
        key, place = (lat, lon, spacing, bit), (lat / 1e7, lon / 1e7)
        self._lacking.pop(key, None)
        heights = await asyncio.to_thread(block, self._elevation.height, *place, spacing, bit)
        if heights is None:  # it stays unknown to the vehicle, which then refuses to rely on it
            self._lacking[key] = await asyncio.to_thread(self._lacks, *place, spacing, bit)
            if len(self._lacking) > _MOST:
                del self._lacking[next(iter(self._lacking))]
            return
        message = self._hub.dialect.module.MAVLink_terrain_data_message(
            lat, lon, spacing, bit, heights
        )
        self._hub.send(self._vehicle, message)
        await asyncio.sleep(_PAUSE)

    def _lacks(self, lat: float, lon: float, spacing: float, bit: int) -> set[str]:
        """Return the tiles that a block lacks, by its corners."""
        south, west = bit // _ACROSS * _SIDE, bit % _ACROSS * _SIDE
        corners = [
            _displaced(lat, lon, north * spacing, east * spacing)
            for north in (south, south + _SIDE - 1)
            for east in (west, west + _SIDE - 1)
        ]
        return {
            tile_at(*place)
            for place in corners
            if abs(place[0]) < 90 and self._elevation.height(*place) is None
        }
