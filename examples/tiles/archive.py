"""Write vector tiles (Mapbox Vector Tile 2.1) into a PMTiles archive (version 3)."""

from __future__ import annotations

import gzip
import itertools
import json
import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

POINT, LINE, POLYGON = 1, 2, 3
EXTENT = 4096  # steps along the side of a tile
MARGIN = 64  # steps beyond it, so that no edge shows
GZIP, VECTOR = 2, 1

Point = tuple[float, float]


class Feature(NamedTuple):
    """A point, a line, or the outer ring of a polygon; its places are parts of the map of the world."""

    what: int
    tags: Mapping[str, str]
    places: Sequence[Point]


Layer = list[Feature]


def written(
    layers: Mapping[str, Layer], zooms: Sequence[int], *, name: str, attribution: str
) -> bytes:
    """Return an archive with the tiles of all zooms that hold something."""
    tiles: dict[int, bytes] = {}
    for zoom in zooms:
        for x, y in _touched(layers, zoom):
            body = _tile(layers, zoom, x, y)
            if body:
                tiles[_tile_id(zoom, x, y)] = gzip.compress(body, mtime=0)
    about = {
        "name": name,
        "attribution": attribution,
        "vector_layers": [
            {"id": layer, "fields": {"kind": "String", "name": "String"}} for layer in layers
        ],
    }
    return _archive(tiles, about, layers, zooms)


def _touched(layers: Mapping[str, Layer], zoom: int) -> Iterable[tuple[int, int]]:
    west, north, east, south = _bounds(layers)
    across = 1 << zoom
    for x in range(int(west * across), int(east * across) + 1):
        for y in range(int(north * across), int(south * across) + 1):
            yield x, y


def _bounds(layers: Mapping[str, Layer]) -> tuple[float, float, float, float]:
    places = [place for layer in layers.values() for shape in layer for place in shape.places]
    xs, ys = [x for x, _ in places], [y for _, y in places]
    return min(xs), min(ys), max(xs), max(ys)


# Tiles


def _tile(layers: Mapping[str, Layer], zoom: int, x: int, y: int) -> bytes:
    found = b""
    for name, shapes in layers.items():
        keys: list[str] = []
        values: list[str] = []
        features = b""
        for shape in shapes:
            places = [
                (((px * (1 << zoom)) - x) * EXTENT, ((py * (1 << zoom)) - y) * EXTENT)
                for px, py in shape.places
            ]
            tags: list[int] = []
            for key, value in shape.tags.items():
                tags += [_index(keys, key), _index(values, value)]
            geometry = _ENCODERS[shape.what](places)
            if geometry:
                body = _packed(2, tags) + _varints([3 << 3, shape.what]) + _packed(4, geometry)
                features += _field(2, body)
        if features:
            told = b"".join(_field(3, key.encode()) for key in keys)
            told += b"".join(_field(4, _field(1, value.encode())) for value in values)
            head = _varints([15 << 3, 2]) + _field(1, name.encode())
            found += _field(3, head + features + told + _varints([5 << 3, EXTENT]))
    return found


def _point(places: Sequence[Point]) -> list[int]:
    """Encode a point that is within the tile: its name is written from there, once."""
    (x, y), *_ = _whole(places)
    return _path([(x, y)]) if 0 <= x < EXTENT and 0 <= y < EXTENT else []


def _index(known: list[str], word: str) -> int:
    if word not in known:
        known.append(word)
    return known.index(word)


def _polygon(places: Sequence[Point]) -> list[int]:
    ring = list(places)
    low, high = -MARGIN, EXTENT + MARGIN
    for axis, limit, inside in ((0, low, 1), (0, high, -1), (1, low, 1), (1, high, -1)):
        ring = _cut(ring, axis, limit, inside)
    corners = _whole(ring)
    if len(corners) > 1 and corners[0] == corners[-1]:
        corners.pop()
    if len(corners) < 3:
        return []
    area = sum(
        ax * by - bx * ay
        for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True)
    )
    if area < 0:  # an outer ring turns clockwise on the screen
        corners.reverse()
    return [*_path(corners), (1 << 3) | 7] if area else []


def _cut(ring: Sequence[Point], axis: int, limit: float, inside: int) -> list[Point]:
    found: list[Point] = []
    for start, end in zip(ring, [*ring[1:], *ring[:1]], strict=True):
        a, b = (start[axis] - limit) * inside, (end[axis] - limit) * inside
        if a >= 0:
            found.append(start)
        if (a >= 0) != (b >= 0):
            found.append(_between(start, end, a / (a - b)))
    return found


def _line(places: Sequence[Point]) -> list[int]:
    """Encode the segments that touch the tile, whole: what lies beyond it is not drawn."""
    runs: list[list[Point]] = []
    for start, end in itertools.pairwise(places):
        part = _clipped(start, end)
        if part is None:
            continue
        if runs and runs[-1][-1] == part[0]:
            runs[-1].append(part[1])
        else:
            runs.append(list(part))
    found: list[int] = []
    at = (0, 0)
    for run in runs:
        corners = _whole(run)
        if len(corners) > 1:
            found += _path(corners, at)
            at = corners[-1]
    return found


_ENCODERS = {POINT: _point, LINE: _line, POLYGON: _polygon}


def _clipped(start: Point, end: Point) -> tuple[Point, Point] | None:
    low, high = -MARGIN, EXTENT + MARGIN
    first, last = 0.0, 1.0
    for axis in (0, 1):
        along = end[axis] - start[axis]
        if along == 0:
            if not low <= start[axis] <= high:
                return None
            continue
        a, b = sorted(((low - start[axis]) / along, (high - start[axis]) / along))
        first, last = max(first, a), min(last, b)
    if first >= last:
        return None
    return _between(start, end, first), _between(start, end, last)


def _between(start: Point, end: Point, part: float) -> Point:
    if part in (0, 1):
        return start if part == 0 else end
    return (start[0] + (end[0] - start[0]) * part, start[1] + (end[1] - start[1]) * part)


def _whole(places: Iterable[Point]) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for x, y in places:
        at = (round(x), round(y))
        if not found or found[-1] != at:
            found.append(at)
    return found


def _path(places: Sequence[tuple[int, int]], at: tuple[int, int] = (0, 0)) -> list[int]:
    found: list[int] = [(1 << 3) | 1]
    for number, (x, y) in enumerate(places):
        if number == 1:
            found.append(((len(places) - 1) << 3) | 2)
        dx, dy = x - at[0], y - at[1]
        found += [(dx << 1) ^ (dx >> 63), (dy << 1) ^ (dy >> 63)]
        at = (x, y)
    return found


# Protocol buffers


def _varints(numbers: Iterable[int]) -> bytes:
    out = bytearray()
    for number in numbers:
        left = number
        while left > 0x7F:
            out.append(left & 0x7F | 0x80)
            left >>= 7
        out.append(left)
    return bytes(out)


def _field(number: int, body: bytes) -> bytes:
    return _varints([number << 3 | 2, len(body)]) + body


def _packed(number: int, numbers: Iterable[int]) -> bytes:
    return _field(number, _varints(numbers))


# The archive


def _tile_id(zoom: int, x: int, y: int) -> int:
    """Return the place of a tile on the Hilbert curve, after all smaller zooms."""
    found = (4**zoom - 1) // 3
    for level in reversed(range(zoom)):
        side = 1 << level
        right, down = int(bool(x & side)), int(bool(y & side))
        found += side * side * ((3 * right) ^ down)
        if not down:
            if right:
                x, y = side - 1 - x, side - 1 - y
            x, y = y, x
    return found


def _archive(
    tiles: Mapping[int, bytes], about: object, layers: Mapping[str, Layer], zooms: Sequence[int]
) -> bytes:
    ids = sorted(tiles)
    lengths = [len(tiles[one]) for one in ids]
    deltas = [one - before for one, before in zip(ids, [0, *ids], strict=False)]
    # Each begins where the one before it ends, which is written as 0.
    offsets = [1] + [0] * (len(ids) - 1)
    directory = _varints([len(ids), *deltas, *[1] * len(ids), *lengths, *offsets])
    root = gzip.compress(directory, mtime=0)
    facts = gzip.compress(json.dumps(about).encode(), mtime=0)
    data = b"".join(tiles[one] for one in ids)
    begin = 127
    after = begin + len(root) + len(facts)
    numbers = [begin, len(root), begin + len(root), len(facts), after, 0, after, len(data)]
    head = b"PMTiles\x03" + struct.pack("<11Q", *numbers, len(ids), len(ids), len(ids))
    west, north, east, south = _bounds(layers)
    corners = [*_degrees(west, south), *_degrees(east, north)]
    middle = _degrees((west + east) / 2, (north + south) / 2)
    head += bytes([1, GZIP, GZIP, VECTOR, min(zooms), max(zooms)]) + struct.pack("<4i", *corners)
    head += bytes([min(zooms) + 5]) + struct.pack("<2i", *middle)
    return head + root + facts + data


def _degrees(x: float, y: float) -> tuple[int, int]:
    """Return longitude and latitude in 1e-7 degrees."""
    latitude = math.degrees(2 * math.atan(math.exp((0.5 - y) * math.tau)) - math.pi / 2)
    return round((x - 0.5) * 3.6e9), round(latitude * 1e7)
