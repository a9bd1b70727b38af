"""Point clouds as the nearest obstacle by sector and height."""

from __future__ import annotations

import base64
import binascii
import math
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

from rcp_mcp.scans import SECTORS, sector_of, told
from rcp_protocol.plain import is_list, is_map

__all__ = ["is_cloud", "obstacles"]

_FORMATS = {7: "f", 8: "d"}
_MOST = 50_000  # points that are looked at, evenly spread over the cloud
_FLOOR = 0.02  # of the points lie below the floor, by noise
_ABOVE = 0.1  # m: what is lower belongs to the floor
_BANDS = (("low", 0.5), ("middle", 1.5), ("high", math.inf))
"""Heights above the floor, each up to so many metres."""
_HEIGHTS = "above the floor: low 0.1 to 0.5 m, middle to 1.5 m, high above"
Point = tuple[float, float, float]


class _Layout(NamedTuple):
    order: tuple[int, int, int]
    """Where x, y and z are among the unpacked numbers."""
    points: struct.Struct


def is_cloud(node: Any) -> bool:
    """Return whether a value is a point cloud as ROS 2 has it."""
    return is_map(node) and _layout(node) is not None and isinstance(node.get("data"), (str, list))


def obstacles(cloud: dict[str, Any]) -> dict[str, Any] | None:
    """Return the nearest obstacle of each sector at each height: distance and bearing as in a scan.

    What has no echo is left out: a cloud does not tell where its sensor looks. None: its bytes
    are broken.
    """
    frame = (cloud.get("header") or {}).get("frame_id") or cloud.get("frame_id") or ""
    try:
        points = list(_points(cloud, optical="optical" in str(frame)))
    except (binascii.Error, ValueError, TypeError, struct.error):
        return None
    facts: dict[str, Any] = {"points": _count(cloud), "frame_id": frame}
    if not points:
        return {"nearest_by_sector": {}, **facts}
    levels = sorted(z for _, _, z in points)
    floor = levels[int(len(levels) * _FLOOR)]
    best: dict[tuple[str, str], tuple[float, float]] = {}
    for x, y, z in points:
        if z - floor < _ABOVE:
            continue
        angle, distance = math.atan2(y, x), math.hypot(x, y)
        key = sector_of(angle), next(name for name, top in _BANDS if z - floor < top)
        if key not in best or distance < best[key][0]:
            best[key] = distance, angle
    found = {
        sector: {band: told(*best[sector, band]) for band, _ in _BANDS if (sector, band) in best}
        for sector in SECTORS
        if any((sector, band) in best for band, _ in _BANDS)
    }
    return {"nearest_by_sector": found, "heights": _HEIGHTS, "floor_z": round(floor, 2), **facts}


def _count(cloud: dict[str, Any]) -> int:
    return int(cloud["width"]) * int(cloud["height"])


def _layout(node: dict[str, Any]) -> _Layout | None:
    """Return how to read the coordinates of each point; None if it has none."""
    fields, step = node.get("fields"), node.get("point_step")
    if not is_list(fields) or not isinstance(step, int) or not 0 < step <= 4096:
        return None
    if not all(isinstance(node.get(key), int) for key in ("width", "height")):
        return None
    found: dict[str, tuple[int, str]] = {}
    for one in fields:
        if is_map(one) and one.get("name") in ("x", "y", "z"):
            offset, code = one.get("offset"), _FORMATS.get(one.get("datatype") or 0)
            if isinstance(offset, int) and offset >= 0 and code is not None:
                found[one["name"]] = offset, code
    if len(found) < 3:
        return None
    text, at = ">" if node.get("is_bigendian") else "<", 0
    names = sorted(found, key=lambda name: found[name])
    for name in names:
        offset, code = found[name]
        if offset < at:
            return None
        text += f"{offset - at}x{code}"
        at = offset + struct.calcsize(f"<{code}")
    if at > step:
        return None
    x, y, z = (names.index(name) for name in "xyz")
    return _Layout((x, y, z), struct.Struct(f"{text}{step - at}x"))


def _points(cloud: dict[str, Any], *, optical: bool) -> Iterator[Point]:
    """Iterate over the points that have an echo: ahead, to the left, up."""
    layout = _layout(cloud)
    assert layout is not None  # it is a cloud
    data: Any = cloud["data"]
    raw = bytes(data) if is_list(data) else base64.b64decode(data)
    size = layout.points.size
    width, row = int(cloud["width"]) * size, cloud.get("row_step")
    if isinstance(row, int) and row > width > 0:
        raw = b"".join(raw[at : at + width] for at in range(0, len(raw), row))
    count = min(_count(cloud), len(raw) // size)
    every = -(-count // _MOST) or 1
    ix, iy, iz = layout.order
    for at in range(0, count * size, every * size):
        numbers = layout.points.unpack_from(raw, at)
        x, y, z = numbers[ix], numbers[iy], numbers[iz]
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)) or x == y == z == 0:
            continue
        # An optical frame of ROS has z ahead, x to the right and y down.
        yield (z, -x, -y) if optical else (x, y, z)
