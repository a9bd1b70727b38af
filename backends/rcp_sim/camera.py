"""A small forward camera: walls and boxes in perspective, as a PNG with a palette.

The picture is rendered column by column, since each column sees one face, and then transposed.
"""

from __future__ import annotations

import math
import struct
import zlib

from rcp_kernel.clock import iso
from rcp_sim.messages import Image
from rcp_sim.raycast import Fan
from rcp_sim.simulation import Simulation

__all__ = ["EYE", "HEIGHT", "TALL", "TONES", "WIDTH", "picture"]

WIDTH, HEIGHT = 160, 120  # px
_FOCUS = WIDTH / 2 / math.tan(math.radians(35))  # px, 70 degrees wide
EYE = 0.4  # m above the floor
TALL = (2.5, 1.8)  # m: the walls of the hall, and the boxes
_REACH = 150.0  # m, greater than any hall
_SHADES = 16  # shades of each tone, darker with distance
TONES = (
    (196, 190, 176),
    (176, 170, 156),  # walls
    (66, 110, 160),
    (54, 92, 136),  # boxes: three colours with two sides each
    (186, 120, 52),
    (158, 100, 44),
    (92, 140, 84),
    (76, 118, 70),
)
_BANDS: tuple[tuple[tuple[float, int], ...], ...] = (
    ((2.5, 0), (1.2, 3), (1.05, 0), (0.12, 4)),
    ((1.8, 3), (1.72, 0), (1.24, 5), (1.16, 0), (0.68, 5), (0.6, 0), (0.12, 5)),
)
"""Texture of walls and boxes from the top: minimum height (m) and shades darker; a stripe, a
skirting, and the shelves."""
_GROUND = (0.0, 0)
_SEAMS = ((4.0, 0.05, 3), (3.0, 0.1, 6))  # m, spacing and width, and shades darker
_FAN = Fan([math.atan((column - WIDTH / 2 + 0.5) / _FOCUS) for column in range(WIDTH)])
_COSINES = [math.cos(angle) for angle in _FAN.angles]
_FIRST = 120  # palette index of the first tone; the background is below it


def _palette() -> bytes:
    colours: list[tuple[int, int, int]] = []
    for row in range(HEIGHT):
        depth = abs(row - HEIGHT / 2) / (HEIGHT / 2)
        base = (120, 128, 140) if row < HEIGHT / 2 else (104, 98, 92)
        colours.append(_dimmed(base, 0.35 + 0.65 * depth))
    for tone in TONES:
        colours += [_dimmed(tone, 1 - 0.75 * shade / _SHADES) for shade in range(_SHADES)]
    return b"".join(bytes(colour) for colour in colours)


def _dimmed(colour: tuple[int, int, int], by: float) -> tuple[int, int, int]:
    red, green, blue = colour
    return int(red * by), int(green * by), int(blue * by)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


_HEAD = b"\x89PNG\r\n\x1a\n" + _chunk(
    b"IHDR", struct.pack(">IIBBBBB", WIDTH, HEIGHT, 8, 3, 0, 0, 0)
)
_PALETTE = _chunk(b"PLTE", _palette())
_END = _chunk(b"IEND", b"")
_BACKGROUND = bytes(range(HEIGHT))


def _column(distance: float, tone: int, along: float) -> bytes:
    """Paint one column, top to bottom, for a position along a face at this distance."""
    box = tone >= 2
    apart, wide, darker = _SEAMS[box]
    shade = int(distance / 1.5) + (darker if along % apart < wide else 0)
    first = _FIRST + tone * _SHADES
    scale = _FOCUS / distance
    edges = [
        min(HEIGHT, max(0, round(HEIGHT / 2 - scale * (height - EYE))))
        for height, _ in (*_BANDS[box], _GROUND)
    ]
    parts = [_BACKGROUND[: edges[0]]]
    for (_, more), top, bottom in zip(_BANDS[box], edges, edges[1:], strict=False):
        colour = first + min(_SHADES - 1, shade + more)
        parts.append(bytes((colour,)) * (bottom - top))
    return b"".join([*parts, _BACKGROUND[edges[-1] :]])


def picture(sim: Simulation, now: int) -> Image:
    """Render what is ahead of the rover."""
    rover, faces = sim.rover, sim.world.faces
    ranges, hits = _FAN.cast(faces, rover.x, rover.y, rover.yaw, _REACH)
    columns: list[bytes] = []
    for distance, angle, cosine, hit in zip(ranges, _FAN.angles, _COSINES, hits, strict=True):
        if hit < 0:
            columns.append(_BACKGROUND)
            continue
        face, bearing = faces[hit], rover.yaw + angle
        along = rover.y + distance * math.sin(bearing)
        if not face.upright:
            along = rover.x + distance * math.cos(bearing)
        columns.append(_column(max(0.05, distance * cosine), face.tone, along))
    columns.reverse()  # rays go from right to left
    pixels = b"".join(columns)
    rows = b"".join(b"\x00" + pixels[row::HEIGHT] for row in range(HEIGHT))
    data = _HEAD + _PALETTE + _chunk(b"IDAT", zlib.compress(rows, 1)) + _END
    return Image(WIDTH, HEIGHT, data, timestamp=iso(now))
