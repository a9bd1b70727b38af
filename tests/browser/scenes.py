"""What a test's robots tell for the scene: the fields by which messages are known, and a page that shows them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from playwright.async_api import Locator, expect

from browser.scenery import hues
from browser.watched import Watched
from browser.worlds import World
from rcp_kernel.model import Resource

__all__ = ["BLUE", "GREEN", "RED", "ROBOTS", "Site", "listed", "mark", "points", "shows"]

MIDDLE = (0.0, 0.0)
HERE = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"w": 1.0}}
RED, GREEN, BLUE = (
    {"r": r, "g": g, "b": b, "a": 1.0} for r, g, b in ((1, 0, 0), (0, 1, 0), (0, 0, 1))
)


class Pose(msgspec.Struct):
    """Where something is."""

    position: Any = None
    orientation: Any = None
    header: Any = None


class Marker(msgspec.Struct):
    """Has the fields of a marker, of whatever type."""

    header: Any = None
    ns: Any = None
    id: Any = None
    type: Any = None
    action: Any = None
    scale: Any = None
    pose: Any = None
    color: Any = None
    lifetime: Any = None
    points: Any = None
    colors: Any = None
    text: Any = None


class Markers(msgspec.Struct):
    markers: list[Marker]


class Grid(msgspec.Struct):
    header: Any = None
    info: Any = None
    data: Any = None


class Update(msgspec.Struct):
    x: Any = None
    y: Any = None
    width: Any = None
    height: Any = None
    data: Any = None


class Poses(msgspec.Struct):
    poses: list[Pose]
    header: Any = None


class Polygon(msgspec.Struct):
    polygon: Any = None
    header: Any = None


class Box(msgspec.Struct):
    center: Any = None
    size: Any = None


class Flat(msgspec.Struct):
    center: Any = None
    size_x: Any = None
    size_y: Any = None


class Thing(msgspec.Struct):
    bbox: Box
    results: Any = None


class Seen(msgspec.Struct):
    bbox: Flat
    results: Any = None


class Things(msgspec.Struct):
    detections: list[Thing]
    header: Any = None


class Sights(msgspec.Struct):
    detections: list[Seen]
    header: Any = None


class Picture(msgspec.Struct):
    width: Any = None
    height: Any = None
    encoding: Any = None
    data: Any = None
    header: Any = None


class Frames(msgspec.Struct):
    transforms: Any = None


class Fix(msgspec.Struct):
    latitude: float
    longitude: float


def told(name: str, value: Any) -> Resource:
    return Resource(name=f"sensor/{name}", description="Whatever it is.", value=value, live=True)


ROBOTS: dict[str, tuple[str, list[Resource]]] = {
    "marks": ("alpha", [told("pose", Pose), told("markers", Markers)]),
    "plans": (
        "beta",
        [
            told("pose", Pose),
            told("map", Grid),
            told("global_costmap/costmap", Grid),
            told("local_costmap/costmap", Grid),
            told("local_costmap/costmap_updates", Update),
            told("particles", Poses),
            told("footprint", Polygon),
            told("things", Things),
        ],
    ),
    "eyes": (
        "gamma",
        [
            told("left/image", Picture),
            told("right/image", Picture),
            told("found", Sights),
            told("frames", Frames),
        ],
    ),
    **{f"rover{n}": (f"site{n}", [told("gps", Fix)]) for n in range(6)},
}


class Site:
    """The gateway, and a page that is logged in to it."""

    def __init__(self, gateway: World, tab: Watched) -> None:
        self.gateway = gateway
        self.tab = tab

    def tell(self, robot: str, name: str, **value: Any) -> None:
        self.gateway.publish(robot, f"sensor/{name}", value)

    async def scene(self, robot: str) -> None:
        """Open the scene with the robot in the middle of the map."""
        await self.tab.open(f"scene?robot={robot}")
        self.tell(robot, "pose", header={"frame_id": "map"}, **HERE)
        await expect(self.tab.page.get_by_test_id("where")).to_contain_text("in map")

    async def seen(
        self, x: float, y: float, so: Callable[[dict[str, int]], bool], told: str
    ) -> None:
        """Wait until the picture has the colours that it ought to have near a place."""
        await self.all_seen({told: (x, y, so)})

    async def all_seen(
        self, wanted: dict[str, tuple[float, float, Callable[[dict[str, int]], bool]]]
    ) -> None:
        """Wait until the picture has the colours that it ought to have near several places."""
        found: dict[str, dict[str, int]] = {}
        try:
            async with asyncio.timeout(60):
                while True:
                    shot = await self.tab.page.screenshot()
                    found = {
                        told: counted
                        for told, (x, y, so) in wanted.items()
                        if not so(counted := await hues(self.tab, x, y, MIDDLE, shot))
                    }
                    if not found:
                        return
        except TimeoutError:
            pytest.fail(f"not as they ought to be: {found}")


def mark(kind: int, x: float, y: float, colour: Any, **more: Any) -> dict[str, Any]:
    """Describe a marker in the map, one metre in size."""
    position = {"x": float(x), "y": float(y), "z": 0.1}
    size = {"x": 0.8, "y": 0.8, "z": 0.8}
    same = {"header": {"frame_id": "map"}, "ns": "all", "action": 0, "scale": size}
    return same | {"id": kind, "type": kind, "pose": {"position": position}, "color": colour} | more


def points(*places: tuple[float, float]) -> list[dict[str, float]]:
    return [{"x": x, "y": y, "z": 0.0} for x, y in places]


def shows(hue: str) -> Callable[[dict[str, int]], bool]:
    return lambda found: found[hue] > 5


async def listed(row: Locator, count: int) -> None:
    await expect(row).to_have_attribute("data-count", str(count))
