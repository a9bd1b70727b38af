"""The ground as the autopilot knows it: grids of heights, asked for from ground stations (`AP_Terrain`)."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from rcp_mavlink_sim.parameters import Parameters
from rcp_mavlink_sim.wire import mav

__all__ = ["Terrain"]

_METRES = 0.011131884502145034
"""Metres of 1e-7 degree of latitude (`LOCATION_SCALING_FACTOR`)."""
_WIDE, _HIGH = 32, 28  # heights of a grid, east and north
_STEP_EAST, _STEP_NORTH = 28, 24  # heights from one grid to the next, which overlap by a block
_ACROSS, _SIDE = 8, 4  # blocks of a grid in a row, and heights along the edge of a block
_ALL = (1 << 56) - 1
_GRIDS = 12
_AGAIN = 2.0  # s between two requests
_NEARBY = (-0.7, 0.0, 0.7)
Place = tuple[int, int]
"""Latitude and longitude, 1e-7 deg."""


class _Grid(msgspec.Struct):
    """One grid, by its south-west corner."""

    corner: Place
    spacing: int
    known: int = 0
    """Its blocks that have come, as bits."""
    heights: dict[tuple[int, int], int] = {}
    """By their index to the north and to the east."""


class Terrain:
    """The grids in the memory of one vehicle; a reboot forgets them, as there is no card."""

    def __init__(self, params: Parameters) -> None:
        self._params = params
        self._grids: dict[Place, _Grid] = {}
        self._asked = -math.inf

    @property
    def enabled(self) -> bool:
        """Whether the vehicle knows of the ground at all."""
        return bool(self._params["TERRAIN_ENABLE"]) and self._spacing > 0

    @property
    def _spacing(self) -> int:
        return int(self._params["TERRAIN_SPACING"])

    # Messages

    def request(self, here: Place, now: float) -> Any:
        """Return TERRAIN_REQUEST of what is missing around a place; None if it is not due."""
        if not self.enabled or now - self._asked < _AGAIN:
            return None
        around = [
            _offset(here, x * _HIGH * self._spacing, y * _WIDE * self._spacing)
            for x in _NEARBY
            for y in _NEARBY
        ]
        grids = [self._grid(place)[0] for place in (here, *around)]
        for grid in (*grids, *self._grids.values()):  # the last are those of TERRAIN_CHECK
            if grid.known != _ALL:
                self._asked = now
                return mav.MAVLink_terrain_request_message(
                    *grid.corner, grid.spacing, _ALL & ~grid.known
                )
        return None

    def take(self, message: Any) -> None:
        """Handle TERRAIN_DATA, if it is of a grid in memory."""
        grid = self._grids.get((message.lat, message.lon))
        bit = message.gridbit
        if grid is None or message.grid_spacing != grid.spacing or not _ALL >> bit & 1:
            return
        north, east = bit // _ACROSS * _SIDE, bit % _ACROSS * _SIDE
        for place, height in enumerate(message.data):
            grid.heights[north + place // _SIDE, east + place % _SIDE] = height
        grid.known |= 1 << bit

    def report(self, place: Place, home: Place | None, above_home: float) -> Any:
        """Return TERRAIN_REPORT of a place; without a spacing, its heights mean nothing."""
        ground = self.height(place)
        reference = None if home is None else self.height(home)
        bits = [grid.known.bit_count() for grid in self._grids.values()]
        counts = (56 * len(bits) - sum(bits), sum(bits))
        if ground is None or reference is None:
            return mav.MAVLink_terrain_report_message(*place, 0, 0.0, 0.0, *counts)
        above = above_home + reference - ground
        return mav.MAVLink_terrain_report_message(*place, self._spacing, ground, above, *counts)

    # Heights

    def height(self, place: Place) -> float | None:
        """Return the height of the ground above the sea, m; None while it is not known."""
        if not self.enabled:
            return None
        grid, north, east = self._grid(place)
        row, column = int(north), int(east)
        fn, fe = north - row, east - column
        corners = [grid.heights.get((row + up, column + on)) for up in (0, 1) for on in (0, 1)]
        if None in corners:
            return None
        a, b, c, d = (float(each or 0) for each in corners)
        return (a * (1 - fe) + b * fe) * (1 - fn) + (c * (1 - fe) + d * fe) * fn

    def above_home(self, place: Place, home: Place | None, above_ground: float) -> float | None:
        """Return a height above the ground at a place as one above home; None if it is not known."""
        ground = self.height(place)
        reference = None if home is None else self.height(home)
        return None if ground is None or reference is None else above_ground + ground - reference

    def _grid(self, place: Place) -> tuple[_Grid, float, float]:
        """Return the grid of a place, made if it is new, and where in it the place is."""
        spacing = self._spacing
        corner = (place[0] // 10**7 * 10**7, place[1] // 10**7 * 10**7)
        half = _scale((corner[0] + place[0]) / 2)
        north = (place[0] - corner[0]) * _METRES / spacing
        east = (place[1] - corner[1]) * _METRES * half / spacing
        up, on = int(north) // _STEP_NORTH * _STEP_NORTH, int(east) // _STEP_EAST * _STEP_EAST
        own = _offset(corner, up * spacing, on * spacing)
        grid = self._grids.pop(own, None)
        if grid is None or grid.spacing != spacing:
            grid = _Grid(own, spacing, heights={})
        self._grids[own] = grid
        while len(self._grids) > _GRIDS:
            del self._grids[next(iter(self._grids))]
        return grid, north - up, east - on


def _offset(place: Place, north: float, east: float) -> Place:
    turn = north / _METRES
    along = east / _METRES / _scale(place[0] + turn / 2)
    return int(place[0] + turn), int(place[1] + along)


def _scale(lat: float) -> float:
    return max(0.01, math.cos(math.radians(lat / 1e7)))
