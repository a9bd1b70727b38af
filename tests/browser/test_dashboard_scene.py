"""What the scene and the cameras of the dashboard draw of markers, costmaps, poses and detections, wrong ones among them."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, Callable
from io import BytesIO
from typing import Any

import msgspec
import pytest
from PIL import Image
from playwright.async_api import Browser, Locator, expect

from browser.scenery import hues, layer, stands
from browser.watched import Watched, log_in, watched
from browser.worlds import KEY, World, world
from rcp_kernel.model import Resource

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
MIDDLE = (0.0, 0.0)
FAR = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"w": 1.0}}
RED, GREEN, BLUE = (
    {"r": r, "g": g, "b": b, "a": 1.0} for r, g, b in ((1, 0, 0), (0, 1, 0), (0, 0, 1))
)
MANY = 120_000


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


def told(name: str, value: Any) -> Resource:
    return Resource(name=f"sensor/{name}", description="Whatever it is.", value=value, live=True)


ROBOTS: dict[str, tuple[str, list[Resource]]] = {
    "marks": ("alpha", [told("pose", Pose), told("markers", Markers), told("single", Marker)]),
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
        [told("left/image", Picture), told("right/image", Picture), told("found", Sights)],
    ),
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
        self.tell(robot, "pose", header={"frame_id": "map"}, **FAR)
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


@pytest.fixture(scope="module")
async def site(browser: Browser) -> AsyncGenerator[Site]:
    async with world(ROBOTS) as gateway, watched(browser, gateway.url) as tab:
        await tab.open()
        await log_in(tab.page, KEY)
        yield Site(gateway, tab)


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


async def test_markers_of_every_type_are_drawn_where_and_as_they_are_told(site: Site) -> None:
    await site.scene("marks")
    line = {"x": 0.3, "y": 0.0, "z": 0.0}
    square = points((-0.4, -0.4), (0.4, -0.4), (0.4, 0.4))
    kinds = [
        mark(0, -6, 4, RED, scale={"x": 1.0, "y": 0.3, "z": 0.3}),
        mark(1, -4, 4, GREEN),
        mark(2, -2, 4, BLUE),
        mark(3, 2, 4, RED),
        mark(4, 4, 4, GREEN, scale=line, points=points((-0.4, 0), (0.4, 0))),
        mark(5, 6, 4, BLUE, scale=line, points=points((0, -0.4), (0, 0.4))),
        mark(6, -6, -4, RED, points=points((0, 0)), colors=[GREEN]),
        mark(7, -4, -4, GREEN, points=points((0, 0))),
        mark(8, -2, -4, BLUE, points=points(*[(n / 20, n / 20) for n in range(-8, 9)])),
        mark(9, 2, -4, RED, text="MMM"),
        mark(11, 6, -4, BLUE, points=square, scale={"x": 1.0, "y": 1.0, "z": 1.0}),
    ]
    site.tell("marks", "markers", markers=kinds)
    row = layer(site.tab, "markers", "/sensor/markers")
    await listed(row, len(kinds))
    wanted = {}
    for one in kinds:
        colour = one.get("colors", [one["color"]])[0]
        hue = max(("r", "red"), ("g", "green"), ("b", "blue"), key=lambda pair: colour[pair[0]])[1]
        at = one["pose"]["position"]
        wanted[f"type {one['type']}"] = (at["x"], at["y"], shows(hue))
    await site.all_seen(wanted)
    await site.tab.shoot("scene-markers")
    assert await row.locator(".bad").count() == 0


async def test_markers_are_replaced_deleted_switched_off_and_end(site: Site) -> None:
    await site.scene("marks")
    row = layer(site.tab, "markers", "/sensor/markers")
    cubes = [mark(1, 2 * n, 2, RED, ns=f"part {n % 2}", id=n) for n in range(4)]
    site.tell("marks", "markers", markers=[{"action": 3}, *cubes])
    await listed(row, 4)
    await stands(row, 3, 2, 0.1)
    site.tell("marks", "markers", markers=[mark(1, 0, 4, GREEN, ns="part 0", id=0)])
    await site.seen(0, 4, lambda found: found["green"] > 20, "the cube that was moved")
    await site.seen(0, 2, lambda found: found["red"] == 0, "where it was before")
    await row.get_by_text("2 namespaces").click()
    await row.get_by_label("part 1").uncheck()
    await site.seen(2, 2, lambda found: found["red"] == 0, "a namespace that is switched off")
    await site.seen(4, 2, lambda found: found["red"] > 20, "the other namespace")
    site.tell("marks", "markers", markers=[{"action": 2, "ns": "part 0", "id": 2}])
    await site.seen(4, 2, lambda found: found["red"] == 0, "a cube that was deleted")
    await listed(row, 3)
    short = mark(1, 6, -4, BLUE, id=9, lifetime={"sec": 1, "nanosec": 500_000_000})
    site.tell("marks", "markers", markers=[short])
    await listed(row, 4)
    await listed(row, 3)
    site.tell("marks", "markers", markers=[{"action": 3}])
    await listed(row, 0)


async def test_wrong_markers_are_named_and_the_others_drawn(site: Site) -> None:
    await site.scene("marks")
    row = layer(site.tab, "markers", "/sensor/markers")
    nan = {"position": {"x": math.nan, "y": 0.0, "z": 0.0}}
    site.tell(
        "marks",
        "markers",
        markers=[
            {"action": 3},
            mark(77, 0, 0, RED),
            mark(1, 0, 0, RED, pose=nan),
            mark(2, 0, 0, RED, scale={"x": -1.0, "y": 1.0, "z": 1.0}),
            mark(8, 0, 0, RED),
            mark(5, 0, 0, RED, points=points((0, 0))),
            mark(3, 4, 4, GREEN),
            mark(0, 0, 0, RED, action=9),
        ],
    )
    await listed(row, 1)
    for words in (
        "unknown type 77",
        "its pose has something that is not a number",
        "its scale is negative",
        "it has no points",
        "points, 1, is no multiple of 2",
        "unknown action 9",
    ):
        await expect(row.locator(".bad")).to_contain_text(words)
    await site.seen(4, 4, lambda found: found["green"] > 20, "the one that is right")
    big = mark(8, 0, 0, RED, points=points(*[(n / MANY, 1.0) for n in range(MANY)]))
    site.tell("marks", "markers", markers=[{"action": 3}, big])
    await expect(row.locator(".bad")).to_contain_text("100,000 of 120,000 points are drawn")
    crowd = [mark(1, 0, 0, GREEN, id=n) for n in range(5003)]
    site.tell("marks", "markers", markers=[{"action": 3}, *crowd])
    await expect(row.locator(".bad")).to_contain_text("3 markers are not drawn: 5,000 is the most")
    site.tell("marks", "single", **mark(1, 4, -4, BLUE, header={"frame_id": "nowhere"}))
    single = layer(site.tab, "markers", "/sensor/single")
    await expect(single.locator(".bad")).to_contain_text("no transform from nowhere to map")
    site.tell("marks", "markers", markers=[{"action": 3}])
    await expect(row.locator(".bad")).to_have_count(0)


def grid(size: int, cell: int, *, metres: float = 0.5) -> dict[str, Any]:
    """Describe a square grid about the middle of the map, all of one value."""
    origin = {"position": {"x": -size * metres / 2, "y": -size * metres / 2, "z": 0.0}}
    info = {"resolution": metres, "width": size, "height": size, "origin": origin}
    return {"header": {"frame_id": "map"}, "info": info, "data": [cell] * size * size}


async def test_costmaps_lie_on_each_other_in_an_order_that_can_be_chosen(site: Site) -> None:
    await site.scene("plans")
    page = site.tab.page
    large, small = (
        layer(site.tab, "costmap", f"/{one}_costmap/costmap") for one in ("global", "local")
    )
    site.tell("plans", "map", **grid(40, 0))
    site.tell("plans", "global_costmap/costmap", **grid(30, 98))
    site.tell("plans", "local_costmap/costmap", **grid(12, 1))
    await listed(layer(site.tab, "map", "/sensor/map"), 1600)
    await listed(large, 900)
    await listed(small, 144)
    await page.get_by_label("Opacity of costmaps").fill("1")
    await site.seen(0, 2, lambda found: found["blue"] > 100, "the small one on top")
    await site.seen(0, 5, lambda found: found["red"] > 100, "the large one around it")
    await site.tab.shoot("scene-costmaps")
    await large.get_by_role("button", name="on top").click()
    await site.seen(0, 2, lambda found: found["red"] > 100, "the large one on top")
    await large.get_by_role("checkbox").uncheck()
    await site.seen(0, 2, lambda found: found["blue"] > 100, "the large one switched off")
    patch = {"x": 0, "y": 8, "width": 12, "height": 4}
    site.tell("plans", "local_costmap/costmap_updates", **patch, data=[98] * 48)
    await site.seen(0, 2, lambda found: found["red"] > 100, "the part that has changed")
    site.tell("plans", "local_costmap/costmap_updates", **(patch | {"x": 5}), data=[98] * 48)
    await expect(small.locator(".bad")).to_contain_text("an update lies outside of it")
    site.tell("plans", "local_costmap/costmap", **(grid(12, 1) | {"data": [0] * 7}))
    await expect(small.locator(".bad")).to_contain_text("it has 7 cells, not 12 x 12")


async def test_poses_polygons_and_detections_are_drawn(site: Site) -> None:
    await site.scene("plans")
    head = {"header": {"frame_id": "map"}}
    spots = [{"position": {"x": x, "y": 3.0, "z": 0.0}} for x in (-1.0, 0.0, 1.0)]
    site.tell("plans", "particles", **head, poses=spots)
    site.tell(
        "plans", "footprint", **head, polygon={"points": points((2, 2), (4, 2), (4, 4), (2, 4))}
    )
    results = [
        {"hypothesis": {"class_id": "chair", "score": 0.2}},
        {"hypothesis": {"class_id": "person", "score": 0.874}},
    ]
    size = {"x": 1.0, "y": 1.0, "z": 2.0}
    box = {"center": {"position": {"x": -3.0, "y": -2.0, "z": 1.0}}, "size": size}
    bad = {"center": {"position": {"x": 0.0, "y": 0.0, "z": 0.0}}, "size": size | {"x": -1.0}}
    site.tell(
        "plans",
        "things",
        **head,
        detections=[{"bbox": box, "results": results}, {"bbox": bad, "results": []}],
    )
    poses = layer(site.tab, "poses", "/sensor/particles")
    await listed(poses, 3)
    await stands(poses, 0, 3, 0)
    await stands(layer(site.tab, "polygon", "/sensor/footprint"), 2.8, 2.8, 0)
    things = layer(site.tab, "detections", "/sensor/things")
    await expect(things.locator(".bad")).to_contain_text("its scale is negative")
    await things.get_by_text("namespaces").click()
    await expect(things.get_by_test_id("namespace").first).to_contain_text("person")
    await site.tab.shoot("scene-detections")


async def test_what_was_detected_is_drawn_over_the_image_it_was_found_in(site: Site) -> None:
    page = site.tab.page
    await site.tab.open("camera?robot=eyes")
    image = {"width": 64, "height": 48, "encoding": "rgb8", "data": bytes(64 * 48 * 3)}
    box = {
        "center": {"position": {"x": 32.0, "y": 24.0}, "theta": 0.0},
        "size_x": 20.0,
        "size_y": 16.0,
    }
    wrong = {"center": {"position": {"x": math.nan, "y": 24.0}}, "size_x": 20.0, "size_y": 16.0}
    results = [{"hypothesis": {"class_id": "cone", "score": 0.91}}]
    found = [{"bbox": box, "results": results}, {"bbox": wrong, "results": results}]
    left, right = (
        page.locator(f"[data-testid=camera][data-path$='{side}/image']")
        for side in ("left", "right")
    )
    async with asyncio.timeout(20):
        while await left.get_by_test_id("boxes").get_attribute("data-boxes") != "cone 91 %":
            site.tell("eyes", "left/image", header={"frame_id": "left"}, **image)
            site.tell("eyes", "right/image", header={"frame_id": "right"}, **image)
            site.tell("eyes", "found", header={"frame_id": "left"}, detections=found)
            await asyncio.sleep(0.05)
    await expect(left.get_by_test_id("found-problem")).to_contain_text("1 box is not drawn")
    await expect(right.get_by_test_id("boxes")).to_have_attribute("data-boxes", "")
    frame = left.get_by_test_id("boxes")
    shot = Image.open(BytesIO(await frame.screenshot())).convert("RGB")
    assert any(sum(shot.getpixel((x, shot.height // 2))) > 150 for x in range(shot.width))  # type: ignore[arg-type]
    await site.tab.shoot("camera-detections")
    await left.get_by_label("detections").uncheck()
    await expect(frame).to_have_attribute("data-boxes", "")
