"""What the scene and the cameras of the dashboard draw of markers, costmaps, poses and detections, wrong ones among them."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator
from io import BytesIO
from typing import Any

import pytest
from PIL import Image
from playwright.async_api import Browser, expect

from browser.scenery import layer, stands
from browser.scenes import BLUE, GREEN, RED, ROBOTS, Site, listed, mark, points, shows
from browser.watched import log_in, watched
from browser.worlds import KEY, world

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms


@pytest.fixture(scope="module")
async def site(browser: Browser) -> AsyncGenerator[Site]:
    async with world(ROBOTS) as gateway, watched(browser, gateway.url) as tab:
        await tab.open()
        await log_in(tab.page, KEY)
        yield Site(gateway, tab)


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
    crowd = [mark(1, 0, 0, GREEN, id=n) for n in range(5003)]
    site.tell("marks", "markers", markers=[{"action": 3}, *crowd])
    await expect(row.locator(".bad")).to_contain_text("3 markers are not drawn: 5,000 is the most")
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
    await things.get_by_text("1 namespace").click()
    await expect(things.get_by_test_id("namespace")).to_contain_text("person")
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
    async with asyncio.timeout(60):
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


async def test_names_do_not_cover_each_other_and_those_without_room_are_counted(site: Site) -> None:
    await site.tab.open("scene?robot=eyes")
    page = site.tab.page

    def stand(apart: float) -> None:
        frames = [
            {
                "header": {"frame_id": "map"},
                "child_frame_id": f"frame_{n}",
                "transform": {"translation": {"x": 0.0, "y": apart * (n - 3), "z": 0.0}},
            }
            for n in range(6)
        ]
        site.tell("eyes", "frames", transforms=frames)

    stand(0.0)
    await expect(page.get_by_test_id("unnamed")).to_have_text("3 names have no room: zoom in")
    await site.tab.shoot("scene-names")
    stand(3.0)
    await expect(page.get_by_test_id("unnamed")).to_have_count(0)


async def test_names_on_the_map_do_not_cover_each_other(site: Site) -> None:
    await site.tab.open("map")
    canvas = site.tab.page.get_by_test_id("map")
    for apart, names in ((0.0, "4"), (0.001, "6")):
        for n in range(6):
            site.tell(f"rover{n}", "gps", latitude=47.0 + apart * n, longitude=8.0)
        await expect(site.tab.page.get_by_test_id("map")).to_have_attribute("data-tracks", "6")
        if apart:
            await site.tab.page.get_by_role("button", name="Fit").click()
        await expect(canvas).to_have_attribute("data-named", names)
        await site.tab.shoot(f"map-names-{names}")


async def test_a_transform_that_is_no_place_is_named_and_the_next_one_is_drawn(site: Site) -> None:
    await site.tab.open("scene?robot=eyes")
    page = site.tab.page

    def stand(x: float) -> None:
        place = {"translation": {"x": x, "y": 0.0, "z": 0.0}}
        link = {"header": {"frame_id": "map"}, "child_frame_id": "base_link", "transform": place}
        site.tell("eyes", "frames", transforms=[link])

    stand(math.nan)
    wrong = page.get_by_test_id("layers").locator(".bad")
    await expect(wrong).to_contain_text("base_link: its pose has something that is not a number")
    stand(3.0)
    await expect(page.get_by_test_id("where")).to_contain_text("3.00, 0.00 m")
    await expect(wrong).to_have_count(0)


async def test_a_robot_that_has_gone_leaves_nothing_behind(site: Site) -> None:
    await site.scene("marks")
    row = layer(site.tab, "markers", "/sensor/markers")
    site.tell("marks", "markers", markers=[mark(1, 0, 4, RED)])
    await listed(row, 1)
    site.gateway.robots["marks"].remove("sensor/markers", "sensor/pose")
    await expect(row).to_have_count(0)
    await expect(site.tab.page.get_by_test_id("where")).to_be_empty()
