"""The dashboard's views, with a real browser and the real demo: scene, plots, cameras, map, commands, log."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import AsyncGenerator, Callable
from typing import Any

import httpx
import pytest
from playwright.async_api import Browser, Locator, Page, expect

from browser.watched import Watched, log_in, signed_in
from docs.demo import Demo

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
_BOUND = 60.0  # s
_STILL = 0.02  # m in a quarter of a second
_LEAVE_AND_CHANGE = """
([change, value]) => {
  const field = document.querySelector(change);
  location.hash = "#/explore"; // the page hears of it later
  field.value = value;
  for (const kind of ["input", "change"]) field.dispatchEvent(new Event(kind, { bubbles: true }));
}
"""


class Robot:
    """The demo's rovers as they are, seen past the dashboard."""

    def __init__(self, running: Demo) -> None:
        found = re.search(r"rcp_ad_[\w-]+", running.banner)
        assert found is not None
        self.admin = found[0]
        self._client = httpx.AsyncClient(
            base_url=f"{running.url}/rcp/v1/context",
            headers={"authorization": f"Bearer {found[0]}"},
            timeout=_BOUND,
        )

    async def read(self, path: str) -> Any:
        return (await self._client.get(path)).raise_for_status().json()["body"]

    async def execute(self, path: str, value: Any) -> None:
        (await self._client.post(path, json=value, params={"wait": 10})).raise_for_status()

    async def place(self, tenant: str = "alpha") -> tuple[float, float]:
        position = (await self.read(f"tenant/{tenant}/sensor/pose"))["position"]
        return position["x"], position["y"]

    async def until(self, so: Callable[[tuple[float, float]], bool], tenant: str = "alpha") -> None:
        async with asyncio.timeout(_BOUND):
            while True:
                if so(await self.place(tenant)):
                    return
                await asyncio.sleep(0.05)

    async def stands(self) -> None:
        """Wait until the rover of alpha does not move any more."""
        async with asyncio.timeout(_BOUND):
            before = await self.place()
            while True:
                await asyncio.sleep(0.25)
                now = await self.place()
                if abs(now[0] - before[0]) + abs(now[1] - before[1]) < _STILL:
                    return
                before = now

    async def home(self) -> None:
        """Carry the rovers back to where they started, and let them move."""
        await self.execute("system/estop", {"reset": True})
        for tenant in ("alpha", "beta"):
            await self.execute(f"tenant/{tenant}/service/reset_system", {"pose": True})

    async def close(self) -> None:
        await self._client.aclose()


@pytest.fixture
async def robot(running: Demo) -> AsyncGenerator[Robot]:
    made = Robot(running)
    await made.home()
    yield made
    await made.close()


@pytest.fixture
async def tab(browser: Browser, running: Demo, robot: Robot) -> AsyncGenerator[Watched]:
    """Open the demo's dashboard for its operator, with the rovers at home."""
    async with signed_in(browser, running.url, running.key, "demo-operator") as found:
        yield found


async def look(tab: Watched, path: str) -> None:
    await tab.open(f"explore?path={path}")
    await expect(tab.page.get_by_role("heading", name=path)).to_be_visible()


async def take_control(page: Page) -> Locator:
    await page.get_by_role("button", name="Take control").click()
    await expect(page.get_by_test_id("control")).to_contain_text("You have control")
    return page.get_by_test_id("stick")


async def push(page: Page, stick: Locator) -> None:
    """Press the stick and push it forward, without letting go."""
    box = await stick.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    await page.mouse.move(x, y)
    await page.mouse.down()
    await page.mouse.move(x, y - box["height"] / 3, steps=4)


async def test_a_command_is_watched_and_cancelled(tab: Watched, robot: Robot) -> None:
    await look(tab, "/tenant/alpha/action/move_to")
    form = tab.page.get_by_test_id("ask-execute")
    await form.locator("[data-pointer='/position/x'] input").fill("8")
    await form.locator("[data-pointer='/position/y'] input").fill("0")
    await form.get_by_role("button", name="Execute", exact=True).click()
    await expect(form.get_by_test_id("running")).to_contain_text("running")
    await tab.open("commands")
    running = tab.page.locator("tr[data-status=in_progress]")
    await expect(running).to_contain_text("alpha action/move_to")
    await tab.shoot("commands-running")
    await running.get_by_role("button", name="Cancel").click()
    await expect(tab.page.locator("tr[data-status=cancelled]").first).to_be_visible()
    await robot.stands()


async def test_the_rover_stops_when_the_page_loses_the_eyes_on_it(
    tab: Watched, robot: Robot
) -> None:
    await tab.open("teleop?robot=rover-alpha")
    await push(tab.page, await take_control(tab.page))
    await robot.until(lambda at: at[0] > 0.2)
    await tab.page.evaluate("""
        Object.defineProperty(document, "hidden", {value: true});
        document.dispatchEvent(new Event("visibilitychange"));
    """)
    await expect(tab.page.get_by_test_id("deadman")).to_contain_text("released")
    await robot.stands()


async def test_a_click_into_the_scene_sends_the_rover_there(tab: Watched, robot: Robot) -> None:
    await tab.open("scene?robot=rover-alpha")
    scene = tab.page.get_by_test_id("scene")
    await expect(scene.locator("canvas")).to_be_visible()
    await expect(tab.page.get_by_test_id("where")).to_contain_text("in map")
    await tab.page.get_by_test_id("aim").click()
    box = await scene.bounding_box()
    assert box is not None
    metre = box["height"] / 24
    await tab.page.mouse.click(
        box["x"] + box["width"] / 2 + 2 * metre, box["y"] + box["height"] / 2 - metre
    )
    await robot.until(lambda at: abs(at[0] - 2) < 0.3 and abs(at[1] - 1) < 0.3)
    await expect(tab.page.get_by_test_id("goal-status")).to_contain_text("completed")
    await tab.shoot("scene-2d")
    await tab.page.get_by_role("button", name="3D").click()
    await expect(tab.page.get_by_test_id("scene")).to_have_attribute("data-drawn", "3d")
    await tab.shoot("scene-3d")


async def test_the_scene_shows_the_rover_as_it_is_described_and_what_it_perceives(
    tab: Watched, robot: Robot
) -> None:
    await tab.open("scene?robot=rover-alpha")
    for kind, path in (
        ("cloud", "sensor/points"),
        ("frames", "laser"),
        ("robot", "param/robot_description"),
        ("map", "sensor/map"),
    ):
        row = tab.page.locator(f"[data-testid=layer][data-layer={kind}][data-path$='{path}']")
        await expect(row).to_have_attribute("data-count", re.compile(r"[1-9]"))
        await expect(row).to_have_attribute("data-at", re.compile(r"\d \S+ \S+"))
    await tab.page.get_by_role("button", name="3D").click()
    await expect(tab.page.get_by_test_id("scene")).to_have_attribute("data-drawn", "3d")
    await tab.shoot("scene-rover")


async def test_a_plot_follows_and_pauses(tab: Watched, robot: Robot) -> None:
    imu = "/tenant/alpha/sensor/imu%23linear_acceleration"
    await tab.open(f"plot?p={imu}.x,{imu}.z&span=10")
    chart = tab.page.get_by_test_id("chart")
    await expect(chart.locator("canvas")).to_be_visible()
    await expect(chart.get_by_test_id("shown").nth(1)).to_have_text(re.compile(r"9\.\d+ m/s"))
    await tab.page.get_by_label("Path").fill("/tenant/alpha/sensor/battery")
    await tab.page.get_by_role("button", name="voltage", exact=True).click()
    await expect(chart).to_have_count(2)
    await tab.shoot("plot")
    await tab.page.get_by_test_id("pause").click()
    await expect(tab.page.get_by_test_id("pause")).to_have_attribute("aria-pressed", "true")
    await tab.page.reload()
    await expect(chart).to_have_count(2)  # the address has kept them
    await tab.page.get_by_role("button", name="Save").click()
    await expect(tab.page.get_by_role("status").get_by_text("kept")).to_be_visible()
    await tab.open("plot?span=10")
    await tab.page.reload()
    await expect(chart).to_have_count(0)
    await tab.page.get_by_role("button", name="Load").click()
    await expect(chart).to_have_count(2)  # and so has the gateway


async def test_a_picture_that_is_old_is_covered(tab: Watched, robot: Robot) -> None:
    await tab.open("camera?robot=rover-alpha")
    camera = tab.page.get_by_test_id("camera")
    await expect(camera).to_have_attribute("data-stale", "false")
    await expect(camera).to_have_attribute("data-frames", re.compile(r"\d"))
    await tab.shoot("camera")
    fault = {"fault": "sensor_stop", "target": "sensor/camera", "seconds": 60}
    await robot.execute("tenant/alpha/service/inject_fault", fault)
    await expect(camera).to_have_attribute("data-stale", "true")
    await expect(camera.get_by_role("alert")).to_contain_text("Do not use it to drive")
    await tab.shoot("camera-stale")


async def test_the_map_shows_who_tells_where_on_earth_it_is(tab: Watched, robot: Robot) -> None:
    await tab.open("map")
    await expect(tab.page.get_by_test_id("map")).to_have_attribute("data-tracks", "1")
    await expect(tab.page.locator("main")).to_contain_text("drone-gamma")
    await tab.shoot("map")


async def test_the_log_has_events_and_for_who_may_the_audit(tab: Watched, robot: Robot) -> None:
    await tab.open("log")
    await expect(tab.page.locator("tr[data-source=event]").first).to_be_visible()
    await expect(tab.page.locator("main")).to_contain_text("cannot see the audit log")
    await tab.page.get_by_role("button", name="Log out").click()
    await log_in(tab.page, robot.admin)
    await expect(tab.page.locator("tr[data-source=audit]").first).to_be_visible()
    await tab.shoot("log")


@pytest.mark.parametrize(
    ("page", "field", "value"),
    [("log", "main input[type=search]", "words"), ("plot", "main select", "300")],
)
async def test_a_page_that_is_being_left_does_not_bring_its_address_back(
    tab: Watched, page: str, field: str, value: str
) -> None:
    await tab.open(page)
    await tab.page.locator(field).first.wait_for()
    await tab.page.evaluate(_LEAVE_AND_CHANGE, [field, value])
    await expect(tab.page.get_by_role("main", name="Explore")).to_be_visible()
    assert tab.page.url.endswith("#/explore")


async def test_the_drone_is_in_the_scene_at_its_height_and_on_the_map_where_it_is(
    tab: Watched, robot: Robot
) -> None:
    async with asyncio.timeout(2 * _BOUND):
        while not (await robot.read("tenant/gamma/sensor/prearm"))["ready"]:  # noqa: ASYNC110
            await asyncio.sleep(0.2)
    await robot.execute("tenant/gamma/action/arm", {})
    await robot.execute("tenant/gamma/action/takeoff", {"altitude": 3})
    await tab.open("scene?robot=drone-gamma")
    await expect(tab.page.get_by_test_id("where")).to_contain_text(
        re.compile(r", [23]\.\d\d m, -?\d+° in map")
    )
    north = (await robot.read("tenant/gamma/sensor/attitude"))["yaw"]
    output = await tab.page.get_by_test_id("where").inner_text()
    turned = re.search(r"(-?\d+)°", output)
    assert turned is not None
    assert abs((90 - math.degrees(north) - int(turned[1]) + 180) % 360 - 180) < 10
    await tab.page.get_by_role("button", name="3D").click()
    await expect(tab.page.get_by_test_id("scene")).to_have_attribute("data-drawn", "3d")
    await tab.shoot("scene-drone")
    await tab.page.get_by_role("button", name="3D").click()
    await tab.page.get_by_test_id("aim").click()
    box = await tab.page.get_by_test_id("scene").bounding_box()
    assert box is not None
    metre = box["height"] / 24
    at = box["x"] + box["width"] / 2 + 3 * metre, box["y"] + box["height"] / 2 - 4 * metre
    await tab.page.mouse.click(*at)
    async with asyncio.timeout(2 * _BOUND):
        while True:
            place = await robot.read("tenant/gamma/sensor/position/local")
            if abs(place["x"] - 4) < 1.2 and abs(place["y"] - 3) < 1.2:
                break
            await asyncio.sleep(0.1)
    there = await robot.read("tenant/gamma/sensor/position/global")
    await tab.open("map")
    await expect(tab.page.locator("main")).to_contain_text(f"{there['lat']:.4f}")
    await robot.execute("tenant/gamma/action/land", {})
