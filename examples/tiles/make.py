"""Make tiles of an invented airfield, for a map without a network: `python make.py field.pmtiles`.

Nothing of it is copied: streets, lake, houses and their names are made up, around the place where
the simulated vehicles begin. `--home LATITUDE LONGITUDE` puts them elsewhere.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

from archive import LINE, POINT, POLYGON, Feature, Layer, Point, written

HOME = (-35.3632621, 149.1652374)  # deg: where the simulated vehicles begin
ZOOMS = range(9, 17)
REACH = 3000  # m from home to the edge of what is known
EARTH = 6_378_137  # m

Shape = tuple[str, int, str, Sequence[Point], str]
"""Layer, what it is, kind, places in m east and north, and its name or an empty text."""


def box(x: float, y: float, width: float, height: float) -> list[Point]:
    """Return the corners of a rectangle about its middle."""
    w, h = width / 2, height / 2
    return [(x - w, y - h), (x + w, y - h), (x + w, y + h), (x - w, y + h)]


def blob(x: float, y: float, radius: float, seed: float) -> list[Point]:
    """Return a round outline that is not quite round."""
    found: list[Point] = []
    for step in range(36):
        angle = step * math.tau / 36
        far = radius * (
            1 + 0.16 * math.sin(3 * angle + seed) + 0.09 * math.sin(5 * angle + 2 * seed)
        )
        found.append((x + far * math.cos(angle), y + far * math.sin(angle)))
    return found


ROADS: list[Shape] = [
    (
        "roads",
        LINE,
        "major",
        [(-3000, -330), (-900, -360), (500, -350), (3000, -520)],
        "Field Road",
    ),
    ("roads", LINE, "major", [(560, 3000), (520, 900), (500, -350), (640, -3000)], "Lake Road"),
    ("roads", LINE, "minor", [(-600, -352), (-560, 260), (-120, 300), (512, 280)], "Hangar Lane"),
    ("roads", LINE, "minor", [(-1750, -350), (-1720, 1900), (530, 1750)], "North Loop"),
    ("roads", LINE, "path", [(-120, 90), (-120, 300), (-500, 620), (-1100, 720)], ""),
]
PLACES: list[Shape] = [
    ("places", POINT, "village", [(-330, 195)], "Testville"),
    ("places", POINT, "forest", [(-1150, 700)], "Pine Wood"),
    ("places", POINT, "lake", [(820, 520)], "Mirror Lake"),
]


def landscape() -> list[Shape]:
    """Return all shapes, those below first."""
    shapes: list[tuple[str, int, str, Sequence[Point]]] = [
        ("earth", POLYGON, "earth", box(0, 0, 2 * REACH, 2 * REACH)),
        ("landuse", POLYGON, "grass", box(0, 0, 900, 620)),
        ("landuse", POLYGON, "forest", blob(-1150, 700, 520, 1)),
        ("landuse", POLYGON, "forest", blob(1500, -1400, 640, 4)),
        ("landuse", POLYGON, "farmland", box(-1300, -900, 900, 700)),
        ("landuse", POLYGON, "farmland", box(900, 1500, 1100, 800)),
        ("water", POLYGON, "lake", blob(820, 520, 300, 2)),
        ("water", LINE, "stream", [(820 + 290, 560), (1500, 800), (2100, 820), (3000, 1100)]),
        ("landuse", POLYGON, "runway", box(0, -60, 760, 24)),
        ("landuse", POLYGON, "runway", box(-120, 20, 16, 140)),
    ]
    for row in range(3):
        for place in range(7):
            house = box(-520 + place * 62, 150 + row * 44, 26 + 5 * (place % 3), 18)
            shapes.append(("buildings", POLYGON, "house", house))
    shapes.append(("buildings", POLYGON, "hangar", box(-120, 118, 70, 40)))
    return [*((*shape, "") for shape in shapes), *ROADS, *PLACES]


def projected(home: tuple[float, float], place: Point) -> Point:
    """Return a place in m from home as parts of the map of the world, from its upper left corner."""
    latitude = home[0] + math.degrees(place[1] / EARTH)
    longitude = home[1] + math.degrees(place[0] / (EARTH * math.cos(math.radians(home[0]))))
    north = math.log(math.tan(math.pi / 4 + math.radians(latitude) / 2))
    return (longitude / 360 + 0.5, 0.5 - north / math.tau)


def made(home: tuple[float, float]) -> bytes:
    """Return the archive."""
    layers: dict[str, Layer] = {}
    for layer, what, kind, places, name in landscape():
        tags = {"kind": kind, "name": name} if name else {"kind": kind}
        shape = Feature(what, tags, [projected(home, place) for place in places])
        layers.setdefault(layer, []).append(shape)
    return written(layers, ZOOMS, name="Invented airfield", attribution="Invented by this example")


def main() -> None:
    """Write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--home", type=float, nargs=2, default=HOME, metavar=("LAT", "LON"))
    asked = parser.parse_args()
    asked.file.write_bytes(made(tuple(asked.home)))


if __name__ == "__main__":
    main()
