"""Cropping and decimating maps and point clouds, from CDR to CDR, without decoding the rest."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from rcp_kernel.errors import ConfigError, DeviceRejected

__all__ = ["Corners", "reduction"]

Corners = tuple[float, ...]
"""The lowest corner, then the highest one, m."""
_HEADER = 4  # bytes of encapsulation, from whose end alignment is counted
_CLOUD, _MAP = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/OccupancyGrid"
_FLOATS = {7: "f4", 8: "f8"}  # of PointField.datatype
_UNKNOWN = -1


def reduction(type_: str, crop: Corners | None, every: int | None) -> Callable[[bytes], bytes]:
    """Return what reduces messages of a type.

    :raises ConfigError: such messages cannot be reduced, or the corners have too many numbers.
    """
    known = {_CLOUD: (_cloud, 6, "x, y, z"), _MAP: (_map, 4, "x, y")}
    if type_ not in known:
        raise ConfigError(f"`crop` and `decimate` are for {_CLOUD} and {_MAP}, not for {type_}")
    reduce, numbers, names = known[type_]
    if crop is not None and len(crop) != numbers:
        raise ConfigError(f"`crop` of a {type_} is {names} of two corners: {numbers} numbers")

    def made(data: bytes) -> bytes:
        try:
            return reduce(data, crop, every or 1)
        except (struct.error, ValueError, OverflowError) as error:
            raise DeviceRejected(f"the message is not a valid {type_}: {error}") from error

    return made


class _Reader:
    """Reads fields one after the other; `at` is the place of the next one."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.order = "<" if data[1:2] == b"\x01" else ">"
        self.at = _HEADER
        self.take("iI")  # of the header: its stamp
        self.text()

    def take(self, letters: str) -> tuple[Any, ...]:
        """Read fields of one width."""
        width = struct.calcsize(letters[-1])
        self.at += -(self.at - _HEADER) % width
        form = struct.Struct(self.order + letters)
        found = form.unpack_from(self._data, self.at)
        self.at += form.size
        return found

    def text(self) -> str:
        """Read a string."""
        (length,) = self.take("I")
        self.at += length
        return self._data[self.at - length : self.at - 1].decode("utf-8", "replace")

    def array(self, dtype: str, length: int) -> Any:
        """Return bytes that follow as an array."""
        import numpy as np

        found = np.frombuffer(self._data, dtype, length, self.at)
        self.at += length
        return found


def _cloud(data: bytes, crop: Corners | None, every: int) -> bytes:
    read = _Reader(data)
    height, width = read.take("II")
    place = read.at - 8
    fields: dict[str, tuple[int, int]] = {}
    for _ in range(read.take("I")[0]):
        name = read.text()
        (offset,), (kind,) = read.take("I"), read.take("B")
        read.take("I")
        fields[name] = (offset, kind)
    (big,), (step,) = read.take("B"), read.take("I")
    between = read.at
    row, length = read.take("II")
    if not step or row < width * step or length < height * row:
        raise ValueError(f"{length} bytes are not {height} rows of {width} points")
    rows = read.array("u1", length)[: height * row].reshape(height, row)
    points = rows[:, : width * step].reshape(height * width, step)
    if crop is not None:
        points = points[_inside(points, fields, ">" if big else "<", crop)]
    points = points[::every]
    size = points.size
    return b"".join(
        (
            data[:place],
            struct.pack(read.order + "II", 1, len(points)),
            data[place + 8 : between],
            struct.pack(read.order + "II", size, size),
            points.tobytes(),
            data[read.at : read.at + 1],  # is_dense
        )
    )


def _inside(points: Any, fields: dict[str, tuple[int, int]], order: str, crop: Corners) -> Any:
    """Return which points are between the corners; those without a place are not."""
    import numpy as np

    points = np.ascontiguousarray(points)
    count, step = points.shape
    inside = np.ones(count, bool)
    for name, low, high in zip("xyz", crop[:3], crop[3:], strict=True):
        offset, kind = fields.get(name, (0, 0))
        letters = _FLOATS.get(kind)
        if letters is None:
            raise ValueError(f"it has no {name} as a floating-point number")
        if offset + int(letters[1]) > step:
            raise ValueError(f"{name} is beyond the {step} bytes of a point")
        if count:
            values: Any = np.ndarray((count,), order + letters, points, offset, (step,))
            inside &= (values >= low) & (values <= high)
    return inside


def _map(data: bytes, crop: Corners | None, every: int) -> bytes:
    import numpy as np

    read = _Reader(data)
    read.take("iI")  # map_load_time
    (resolution,) = read.take("f")
    place = read.at - 4
    width, height = read.take("II")
    origin = read.take("7d")
    between = read.at - 56
    (length,) = read.take("I")
    if length != width * height or not resolution > 0:
        raise ValueError(f"{length} cells of {resolution} m are not {width} x {height}")
    cells = read.array("i1", length).reshape(height, width)
    x, y, *rest = origin
    if crop is not None:
        yaw = _yaw(*rest[1:])
        left, low, right, high = _within(crop, x, y, yaw, resolution, width, height)
        cells = cells[low:high, left:right]
        x += (left * math.cos(yaw) - low * math.sin(yaw)) * resolution
        y += (left * math.sin(yaw) + low * math.cos(yaw)) * resolution
    if every > 1:
        rows, columns = (-size % every for size in cells.shape)
        cells = np.pad(cells, ((0, rows), (0, columns)), constant_values=_UNKNOWN)
        blocks = cells.reshape(cells.shape[0] // every, every, cells.shape[1] // every, every)
        cells = blocks.max(axis=(1, 3))
    height, width = cells.shape
    return b"".join(
        (
            data[:place],
            struct.pack(read.order + "fII", resolution * every, width, height),
            data[place + 12 : between],  # padding
            struct.pack(read.order + "7dI", x, y, *rest, cells.size),
            cells.tobytes(),
        )
    )


def _yaw(x: float, y: float, z: float, w: float) -> float:
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _within(
    crop: Corners, x: float, y: float, yaw: float, resolution: float, width: int, height: int
) -> tuple[int, int, int, int]:
    """Return the first and the last column and row, exclusive, around a rectangle of the frame."""
    columns, rows = [], []
    for corner in ((crop[i], crop[j]) for i in (0, 2) for j in (1, 3)):
        dx, dy = corner[0] - x, corner[1] - y
        columns.append((dx * math.cos(yaw) + dy * math.sin(yaw)) / resolution)
        rows.append((dy * math.cos(yaw) - dx * math.sin(yaw)) / resolution)

    def bounds(places: list[float], size: int) -> tuple[int, int]:
        first = min(max(math.floor(min(places) + _HAIR), 0), size)
        return first, max(first, min(math.ceil(max(places) - _HAIR), size))

    left, right = bounds(columns, width)
    low, high = bounds(rows, height)
    return left, low, right, high


_HAIR = 1e-6  # cells: a corner on the border of a cell does not take in the next one
