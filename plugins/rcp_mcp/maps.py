"""Occupancy grids as small pictures, with the scale that turns pixels into metres."""

from __future__ import annotations

import base64
import math
from typing import Any, NamedTuple

from PIL import Image, ImageDraw

from rcp_mcp.pictures import Picture, View, drawn
from rcp_protocol.plain import is_list, is_map

__all__ = ["is_grid", "pictured"]

_FREE, _UNKNOWN, _OCCUPIED, _ROBOT = (254,) * 3, (190,) * 3, (0,) * 3, (220, 0, 0)
_WALL = 65  # percent from which a cell counts as occupied
_WALLS = bytes(255 if _WALL <= cell <= 100 else 0 for cell in range(256))
_DARK = bytes(255 if cell > 100 else 0 for cell in range(256))  # -1: unknown
_CELLS = 64_000_000
_DOT = 4  # pixels


class _Grid(NamedTuple):
    width: int
    height: int
    resolution: float
    origin: dict[str, Any]
    cells: bytes


def is_grid(node: Any) -> bool:
    """Return whether a value is an occupancy grid."""
    if not is_map(node) or not isinstance(node.get("data"), (str, list)):
        return False
    facts = node.get("info", node)
    numbers = ("width", "height", "resolution")
    return (
        is_map(facts)
        and is_map(facts.get("origin"))
        and all(isinstance(facts.get(key), (int, float)) for key in numbers)
    )


def pictured(
    node: dict[str, Any], view: View, pose: dict[str, Any] | None
) -> tuple[dict[str, Any], Picture] | None:
    """Return a grid's facts and its picture, north up, with the robot as a red dot.

    `pose` is where the robot is in the grid's frame. None: the cells are not complete.
    """
    grid = _read(node)
    if grid is None:
        return None
    factor = max(1, math.ceil(max(grid.width, grid.height) / view.size))
    walls, dark = (
        Image.frombytes("L", (grid.width, grid.height), grid.cells.translate(table))
        .reduce(factor)
        .transpose(Image.Transpose.FLIP_TOP_BOTTOM)
        for table in (_WALLS, _DARK)
    )
    image = Image.new("RGB", walls.size, _FREE)
    image.paste(_UNKNOWN, mask=dark.point([255 * (share > 127) for share in range(256)]))
    # A thin wall must not vanish: one occupied cell makes its pixel so.
    image.paste(_OCCUPIED, mask=walls.point([255 * (share > 0) for share in range(256)]))
    scale = grid.resolution * factor
    at = grid.origin.get("position") or {}
    left, bottom = float(at.get("x") or 0), float(at.get("y") or 0)
    top = bottom + image.height * scale
    if pose is not None:
        _mark(image, (pose["x"] - left) / scale, (top - pose["y"]) / scale, pose.get("yaw"))
    facts = {key: item for key, item in node.items() if key not in ("data", "info", "origin")}
    facts |= {
        "width": grid.width,
        "height": grid.height,
        "resolution": grid.resolution,
        "picture": {
            "m_per_pixel": round(scale, 4),
            "top_left": {"x": round(left, 3), "y": round(top, 3)},
            "axes": "x to the right, y up; black: occupied, white: free, grey: unknown"
            + ("" if pose is None else ", red: the robot"),
        },
    }
    return facts, drawn(image.quantize(8))


def _read(node: dict[str, Any]) -> _Grid | None:
    facts: dict[str, Any] = node.get("info", node)
    width, height = int(facts["width"]), int(facts["height"])
    if not 0 < width * height <= _CELLS or facts["resolution"] <= 0:
        return None
    data: Any = node["data"]
    try:
        cells = bytes(int(one) & 255 for one in data) if is_list(data) else base64.b64decode(data)
    except (ValueError, TypeError):
        return None
    if len(cells) < width * height:
        return None
    cells = cells[: width * height]
    return _Grid(width, height, float(facts["resolution"]), facts["origin"], cells)


def _mark(image: Image.Image, x: float, y: float, yaw: float | None) -> None:
    if not (0 <= x < image.width and 0 <= y < image.height):
        return
    pen = ImageDraw.Draw(image)
    pen.ellipse((x - _DOT, y - _DOT, x + _DOT, y + _DOT), fill=_ROBOT)
    if yaw is not None:
        ahead = (x + 3 * _DOT * math.cos(yaw), y - 3 * _DOT * math.sin(yaw))
        pen.line((x, y, *ahead), fill=_ROBOT, width=2)
