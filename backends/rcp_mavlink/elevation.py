"""Heights of the ground above the sea, from tiles of SRTM in a folder (`N47E008.hgt`)."""

from __future__ import annotations

import math
import os
import stat
import struct
import threading
from pathlib import Path

import structlog

from rcp_kernel.errors import ConfigError

__all__ = ["Elevation", "tile_at"]

log = structlog.get_logger("rcp.mavlink")
_LOWEST, _HIGHEST = -500, 9_000  # m; what is beyond is a hole (-32768, -9999) or damage
_UNKNOWN = -32768
_SMALLEST, _LARGEST = 2, 10_801  # samples along an edge
_OPEN = 4  # files at once


def tile_at(lat: float, lon: float) -> str:
    """Return the name of the tile of a place, deg: that of its south-west corner."""
    south, west = math.floor(lat), math.floor(_wrapped(lon))
    north, east = "NS"[south < 0], "EW"[west < 0]
    return f"{north}{abs(south):02d}{east}{abs(west):03d}.hgt"


def _wrapped(lon: float) -> float:
    return (lon + 180.0) % 360.0 - 180.0


class Elevation:
    """The tiles of one folder; a height that they do not have is None, never 0.

    Safe to use from threads.
    """

    def __init__(self, folder: str) -> None:
        """:raises ConfigError: there is no such folder."""
        self._folder = Path(folder)
        if not self._folder.is_dir():
            raise ConfigError(
                f"`terrain`: {folder} is no folder; it holds tiles such as N47E008.hgt"
            )
        self._tiles: dict[str, _Tile] = {}
        self._lock = threading.Lock()
        self._refused: set[str] = set()
        self._closed = False

    def height(self, lat: float, lon: float) -> float | None:
        """Return the height of the ground, m above the sea, between its four nearest samples."""
        lon = _wrapped(lon)
        south, west = math.floor(lat), math.floor(lon)
        if not -90 <= south < 90:
            return None
        with self._lock:
            tile = None if self._closed else self._tile(tile_at(south, west))
            return None if tile is None else tile.height(lat - south, lon - west)

    def close(self) -> None:
        """Close the files; nothing is known afterwards."""
        with self._lock:
            self._closed = True
            for tile in self._tiles.values():
                tile.close()
            self._tiles.clear()

    def _tile(self, name: str) -> _Tile | None:
        """Return a tile; one that is missing is looked for again, because it may be added."""
        tile = self._tiles.pop(name, None) or self._opened(name)
        if tile is None:
            return None
        self._tiles[name] = tile
        if len(self._tiles) > _OPEN:
            self._tiles.pop(next(iter(self._tiles))).close()
        return tile

    def _opened(self, name: str) -> _Tile | None:
        try:
            return _Tile(self._folder / name)
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            if name not in self._refused:
                self._refused.add(name)
                log.warning("terrain_tile_refused", tile=name, error=str(error))
            return None


class _Tile:
    """One file: rows from north to south, of big-endian 16-bit heights from west to east."""

    def __init__(self, path: Path) -> None:
        """:raises ValueError: it is no file, or its size is not that of a square of heights."""
        self._file = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe would block
        try:
            found = os.fstat(self._file)
            size = found.st_size
            if not stat.S_ISREG(found.st_mode):
                raise ValueError("it is no file")
            self._edge = math.isqrt(size // 2)
            if self._edge**2 * 2 != size or not _SMALLEST <= self._edge <= _LARGEST:
                raise ValueError(f"{size} bytes are no square of 16-bit heights")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        os.close(self._file)

    def height(self, north: float, east: float) -> float | None:
        """Return the height at fractions of the tile's edge from its south-west corner."""
        last = self._edge - 1
        down, along = (1.0 - north) * last, east * last
        row, column = min(int(down), last - 1), min(int(along), last - 1)
        rows = (self._pair(row, column), self._pair(row + 1, column))
        dy, dx = down - row, along - column
        weights = ((1 - dy) * (1 - dx), (1 - dy) * dx, dy * (1 - dx), dy * dx)
        total = 0.0
        for weight, sample in zip(weights, (*rows[0], *rows[1]), strict=True):
            if weight == 0.0:
                continue
            if not _LOWEST <= sample <= _HIGHEST:  # nobody has measured it
                return None
            total += weight * sample
        return total

    def _pair(self, row: int, column: int) -> tuple[int, int]:
        try:
            data = os.pread(self._file, 4, 2 * (row * self._edge + column))
        except OSError:
            data = b""
        if len(data) < 4:  # it was cut off since it was opened, or its disk is gone
            return _UNKNOWN, _UNKNOWN
        return struct.unpack(">hh", data)
