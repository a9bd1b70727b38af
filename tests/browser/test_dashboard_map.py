"""The operator's map: tiles of an archive, a mission and a fence that are drawn, uploaded and flown by a simulated copter."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
from collections.abc import AsyncGenerator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import httpx
import pytest
from PIL import Image
from playwright.async_api import Browser, FilePayload, Locator, Page, expect

import rcp_mavlink
import rcp_sim
from browser.accessible import SMALL, scrolls_sideways, violations
from browser.input_helpers import held, touching
from browser.machines import key_of
from browser.robots import until, value
from browser.watched import Watched, signed_in
from configuration import backend, key, listener, role, rule, table
from rcp_gateway.testing import serve
from rcp_kernel.config.file import parse

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
MAKE = Path(__file__).parents[2] / "examples" / "tiles" / "make.py"
DRONE = "/tenant/alpha"
OWN = "/system/layouts"
_PLANNED = [f"{DRONE}/action/mission/**", f"{DRONE}/service/**", f"{DRONE}/sensor/**"]
_PLANNED += ["/system/approvals", "/system/status"]
GRASS = (0xD5, 0xE5, 0xC8)
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
_BLIND = """
const real = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return /webgl/.test(kind) ? null : real.call(this, kind, ...rest);
};
"""


@pytest.fixture(scope="module")
async def url(tmp_path_factory: pytest.TempPathFactory) -> AsyncGenerator[str]:
    """Serve a copter four times as fast as real ones, a rover, and tiles around them."""
    tiles = tmp_path_factory.mktemp("tiles") / "field.pmtiles"
    made = await asyncio.to_thread(subprocess.run, [sys.executable, MAKE, tiles], check=True)
    assert made.returncode == 0
    twin = table("backends.twin", warmup=0.5, speed=4, noise=0)
    text = (
        listener()
        + table("plugins.dashboard", tiles=str(tiles))
        + backend("drone", use="mavlink", links=["sim:copter"], on_loss="hold")
        + twin
        + backend("rover", "beta", use="sim")
        + key("otto", key_of("otto"), role="operator")
        + key("ada", key_of("ada"), role="admin")
        + key("lena", key_of("lena"), role="planner")
        + role("planner", rule("*", *_PLANNED), approve=["/action/mission/*"])
    )
    kinds = [*rcp_mavlink.rcp_backends(), *rcp_sim.rcp_backends()]
    async with serve(parse(text, "test"), *kinds) as served:
        yield next(f["url"] for f in served.server.status.transports if "url" in f)


@pytest.fixture
async def drone(url: str) -> AsyncGenerator[httpx.AsyncClient]:
    """Look at the robots past the page."""
    headers = {"authorization": f"Bearer {key_of('otto')}"}
    async with httpx.AsyncClient(base_url=url, headers=headers, timeout=60) as client:
        yield client


@asynccontextmanager
async def opened(
    browser: Browser, url: str, script: str = "", name: str = "otto"
) -> AsyncGenerator[Watched]:
    """Show the map, with the copter on it."""
    async with signed_in(browser, url, key_of(name), name, script) as tab:
        await tab.open("map")
        await expect(tab.page.get_by_test_id("map")).to_have_attribute("data-homes", "1")
        yield tab


async def execute(robot: httpx.AsyncClient, path: str, body: Any = None) -> Any:
    answer = await robot.post(f"/rcp/v1/context{path}", json=body, params={"wait": 60})
    reply = answer.json()
    assert reply["status"] == "completed", reply
    return reply["body"]


class Drawn:
    """What is drawn on: places in pixels from the middle of the map."""

    def __init__(self, page: Page, box: Any) -> None:
        self.page = page
        self._middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def at(self, x: float, y: float) -> tuple[float, float]:
        return self._middle[0] + x, self._middle[1] + y

    async def click(self, *places: tuple[float, float]) -> None:
        for place in places:
            await self.page.mouse.click(*self.at(*place))

    async def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        await self.page.mouse.move(*self.at(*start))
        await self.page.mouse.down()
        await self.page.mouse.move(*self.at(*end), steps=4)
        await self.page.mouse.up()


async def planning(page: Page, what: str = "Mission") -> Drawn:
    """Open the panel of the mission or the fence, and begin to draw."""
    if await page.get_by_test_id("plan-panel").count() == 0:
        await page.get_by_test_id("plan").click()
    await page.get_by_role("button", name=what, exact=True).click()
    await expect(page.get_by_test_id("onboard")).to_contain_text("On the vehicle")
    await page.get_by_test_id("draw").click()
    return Drawn(page, await page.get_by_test_id("map").bounding_box())


def items(page: Page) -> Locator:
    return page.get_by_test_id("mission-items").get_by_role("listitem")


async def uploaded(page: Page, what: str) -> None:
    await page.get_by_test_id("upload").click()
    await expect(page.get_by_test_id("goal-status")).to_contain_text("completed")
    await expect(page.get_by_test_id("onboard")).not_to_contain_text("not uploaded")
    await expect(page.get_by_test_id("onboard")).to_contain_text(what)


def near(x: float, y: float) -> Callable[[Any], bool]:
    """Tell whether a place is so many m east and north of the copter's home."""

    def there(place: Any) -> bool:
        north = (place["latitude"] + 35.3632621) * 111_195
        east = (place["longitude"] - 149.1652374) * 111_195 * 0.8155
        return abs(north - y) < 3 and abs(east - x) < 3

    return there


async def test_tiles_of_the_gateway_lie_below_the_robots(browser: Browser, url: str) -> None:
    async with opened(browser, url) as tab:
        page = tab.page
        await expect(page.get_by_test_id("ground")).to_have_attribute("data-tiles", "drawn")
        await expect(page.get_by_text("Invented by this example")).to_be_visible()
        box = await page.get_by_test_id("map").bounding_box()
        assert box is not None
        middle = box["x"] + box["width"] / 2 + 90, box["y"] + box["height"] / 2 - 60
        spot = {"x": middle[0], "y": middle[1], "width": 4, "height": 4}
        await page.emulate_media(color_scheme="light")
        async with asyncio.timeout(60):
            while await _colour(page, spot) != GRASS:  # noqa: ASYNC110 - it is a picture
                await asyncio.sleep(0.05)
        for _ in range(6):
            await page.get_by_role("button", name="Zoom out").click()
        ground = page.get_by_test_id("ground")
        await expect(ground).to_have_attribute("data-names", re.compile("Testville"))
        await expect(ground).to_have_attribute("data-names", re.compile("Field Road"))
        await tab.shoot("map-tiles")


async def _colour(page: Page, spot: Any) -> Any:
    picture = Image.open(BytesIO(await page.screenshot(clip=spot))).convert("RGB")
    return picture.getpixel((1, 1))


async def test_a_browser_that_cannot_draw_tiles_says_so_and_shows_the_rest(
    browser: Browser, url: str
) -> None:
    async with opened(browser, url, _BLIND) as tab:
        told = tab.page.get_by_test_id("no-tiles")
        await expect(told).to_contain_text("This browser cannot draw the tiles")
        await expect(tab.page.get_by_test_id("map")).to_have_attribute("data-tracks", "1")
        await expect(tab.page.get_by_test_id("broken")).to_have_count(0)


async def test_two_fingers_zoom_the_map_and_draw_nothing(browser: Browser, url: str) -> None:
    async with opened(browser, url) as tab, touching(tab.page) as two:
        page = tab.page
        drawn = await planning(page)
        count = await items(page).get_by_role("button", name="Delete").count()
        await two.down(0, *drawn.at(-100, 0))
        await two.down(1, *drawn.at(100, 0))
        await two.move(a=drawn.at(-200, 0), b=drawn.at(200, 0))
        await two.up(1)
        await two.up(0)
        await expect(items(page).get_by_role("button", name="Delete")).to_have_count(count)
        await drawn.click((160, 0))
        await expect(items(page).get_by_role("button", name="Delete")).to_have_count(count + 1)
        longitude = page.get_by_label(f"Longitude of item {count + 1}")
        east = (float(await longitude.input_value()) - 149.1652374) * 111_320 * 0.8155
        assert east == pytest.approx(20, abs=1.5)  # 160 pixels: 8 in a metre, not 4


async def test_a_robot_without_a_place_on_earth_has_a_map_of_its_own(
    browser: Browser, url: str
) -> None:
    async with opened(browser, url) as tab:
        await tab.page.get_by_label("Map of").select_option(label="Local map of rover")
        await expect(tab.page.get_by_test_id("local-map").locator("canvas")).to_be_visible()
        goals = tab.page.get_by_role("link", name="Goals and layers")
        await expect(goals).to_have_attribute("href", "#/scene?robot=rover")
        await tab.page.get_by_label("Map of").select_option(label="Earth")
        await expect(tab.page.get_by_test_id("map")).to_have_attribute("data-tracks", "1")


async def test_a_fence_is_drawn_with_its_faults_told_and_uploaded(
    browser: Browser, url: str, drone: httpx.AsyncClient
) -> None:
    async with opened(browser, url) as tab:
        page = tab.page
        drawn = await planning(page, "Fence")
        off = page.get_by_test_id("fence-off")
        await expect(off).to_contain_text("does not heed its fence: FENCE_ENABLE is 0")
        findings, upload = page.get_by_test_id("findings"), page.get_by_test_id("upload")
        await drawn.click((-250, -250), (250, -250))
        await expect(findings).to_contain_text("needs three corners")
        await expect(upload).to_be_disabled()
        await drawn.click((250, 250), (-250, 250))
        await expect(findings).to_have_count(0)
        await drawn.drag((250, -250), (-350, 0))
        await expect(findings).to_contain_text("sides cross")
        await page.get_by_role("button", name="Undo").click()
        await expect(findings).to_have_count(0)
        await uploaded(page, "1 area")
        stored = (await execute(drone, f"{DRONE}/service/fence/download"))["items"]
        assert [one["command"] for one in stored] == ["NAV_FENCE_POLYGON_VERTEX_INCLUSION"] * 4
        assert near(62.5, 62.5)(stored[1])
        await drone.put(f"/rcp/v1/context{DRONE}/param/FENCE_ENABLE", json=1)
        await expect(off).to_have_count(0)
        await drone.put(f"/rcp/v1/context{DRONE}/param/FENCE_ENABLE", json=0)
        await tab.shoot("map-fence")
        # A mission that leaves it is told of before it is flown.
        await planning(page)
        await drawn.click((320, 0))
        await expect(findings).to_contain_text("1 (Waypoint) is outside the fence")
        await page.get_by_role("button", name="Discard").click()
        await execute(drone, f"{DRONE}/service/fence/upload", {"items": []})
        # What somebody else uploads is shown.
        items = [{"command": "NAV_WAYPOINT", "latitude": -35.363, "longitude": 149.1653}]
        await execute(drone, f"{DRONE}/action/mission/upload", {"items": items})
        await expect(page.get_by_test_id("onboard")).to_contain_text("1 item.")
        # What is not shown is not run: the vehicle tells only how many items it has.
        items = [{**items[0], "altitude": 30}]
        await execute(drone, f"{DRONE}/action/mission/upload", {"items": items})
        async with held(page.get_by_role("button", name="Run the mission")):
            await expect(page.get_by_test_id("refusal")).to_contain_text("than was shown")
        await expect(page.get_by_label("Altitude of item 1")).to_have_value("30")
        # Nor is it remembered from an earlier look.
        await tab.open("log")
        items = [{**items[0], "altitude": 40}]
        await execute(drone, f"{DRONE}/action/mission/upload", {"items": items})
        await tab.open("map")
        await page.get_by_test_id("plan").click()
        await expect(page.get_by_label("Altitude of item 1")).to_have_value("40")
        await execute(drone, f"{DRONE}/service/mission/clear")
        await expect(page.get_by_test_id("onboard")).to_contain_text("no mission")


async def test_a_plan_file_is_saved_and_loaded_after_a_question(
    browser: Browser, url: str, drone: httpx.AsyncClient
) -> None:
    async with opened(browser, url) as tab:
        page = tab.page
        await page.get_by_test_id("plan").click()
        async with page.expect_download() as saving:
            await page.get_by_role("button", name="Save as a file").click()
        saved = await (await saving.value).path()
        text = await asyncio.to_thread(saved.read_text)
        assert '"fileType": "Plan"' in text
        picker = page.get_by_label("Plan file")
        wrong = FilePayload(name="x.plan", mimeType="application/json", buffer=b"{}")
        await picker.set_input_files(wrong)
        await page.get_by_role("button", name="Load it into the vehicle").click()
        await expect(page.get_by_test_id("refusal")).to_contain_text("Plan")
        lines = "QGC WPL 110\n0 1 0 16 0 0 0 0 -35.36 149.16 584 1\n1 0 3 22 0 0 0 0 0 0 7 1\n"
        right = FilePayload(name="y.waypoints", mimeType="text/plain", buffer=lines.encode())
        await picker.set_input_files(right)
        await expect(page.get_by_text("Load y.waypoints into drone?")).to_be_visible()
        assert (await execute(drone, f"{DRONE}/service/mission/download"))["items"] == []
        await page.get_by_role("button", name="Load it into the vehicle").click()
        await expect(page.get_by_test_id("onboard")).to_contain_text("1 item.")
        await execute(drone, f"{DRONE}/service/mission/clear")


async def test_a_mission_is_drawn_uploaded_flown_watched_and_ended(
    browser: Browser, url: str, drone: httpx.AsyncClient
) -> None:
    async with opened(browser, url) as tab, AsyncExitStack() as after:
        page = tab.page
        drawn = await planning(page)
        await page.get_by_label("Height of new waypoints").fill("6")
        await drawn.click((100, 0), (200, -100))
        await page.get_by_role("button", name="+ Take off").click()
        await drawn.drag((100, 0), (120, -80))
        await page.get_by_label("Altitude of item 3").fill("8")
        await page.get_by_label("Altitude of item 3").press("Enter")
        await page.get_by_role("button", name="+ Return home").click()
        await expect(items(page)).to_have_count(4)
        await page.get_by_role("button", name="Check").click()
        await expect(page.get_by_text("The gateway would accept it.")).to_be_visible()
        assert (await execute(drone, f"{DRONE}/service/mission/download"))["items"] == []
        await uploaded(page, "4 items")
        stored = (await execute(drone, f"{DRONE}/service/mission/download"))["items"]
        assert [(one["command"], one["altitude"]) for one in stored] == [
            ("NAV_TAKEOFF", 6),
            ("NAV_WAYPOINT", 6),
            ("NAV_WAYPOINT", 8),
            ("NAV_RETURN_TO_LAUNCH", 0),
        ]
        assert near(30, 20)(stored[1])
        assert near(50, 25)(stored[2])
        run = page.get_by_role("button", name="Run the mission")
        async with held(run):
            await expect(page.get_by_test_id("refusal")).to_contain_text("not armed")
        await expect(page.get_by_test_id("refusal")).to_contain_text("Arm it first")
        await until(drone, f"{DRONE}/sensor/prearm", lambda one: one["ready"])
        await execute(drone, f"{DRONE}/action/arm", {})
        after.push_async_callback(execute, drone, f"{DRONE}/action/disarm", {"force": True})
        async with held(run):
            await expect(page.get_by_test_id("mission-progress")).to_be_visible()
        panel = page.get_by_test_id("plan-panel")
        await expect(panel).to_have_attribute("data-current", "1")
        await expect(items(page).nth(1)).to_have_attribute("aria-current", "step")
        await tab.shoot("map-mission")
        await page.get_by_role("button", name="Cancel").click()
        await expect(page.get_by_test_id("goal-status")).to_contain_text("cancelled")
        assert await value(drone, f"{DRONE}/sensor/mode") != "AUTO"
        # A goal of its own, with its height.
        await page.get_by_role("button", name="Mission and fence").click()
        await page.get_by_label("Altitude of the goal").fill("9")
        await page.get_by_test_id("aim").click()
        middle = Drawn(page, await page.get_by_test_id("map").bounding_box())
        await middle.click((-60, 40))
        await expect(page.get_by_test_id("goal-status")).to_contain_text("completed")
        place = await value(drone, f"{DRONE}/sensor/position/global")
        assert abs(place["relative_alt"] - 9) < 1.5


async def test_heights_are_asked_of_whoever_may_not_take_off_and_an_approved_upload_is_read_back(
    browser: Browser, url: str, drone: httpx.AsyncClient
) -> None:
    await execute(drone, f"{DRONE}/service/mission/clear")
    async with opened(browser, url, name="lena") as tab:
        page = tab.page
        drawn = await planning(page)
        height = page.get_by_label("Height of new waypoints")
        await height.fill("")
        await drawn.click((100, 0))
        findings, upload = page.get_by_test_id("findings"), page.get_by_test_id("upload")
        await expect(findings).to_contain_text("1 (Waypoint) needs a place and a height")
        await expect(upload).to_be_disabled()
        await page.get_by_role("button", name="Undo").click()
        await height.fill("6")
        await drawn.click((100, 0))
        await expect(page.get_by_label("Altitude of item 1")).to_have_value("6")
        await upload.click()
        await expect(page.get_by_test_id("kept")).to_contain_text("NAV_WAYPOINT")
        await page.get_by_role("button", name="Ask for approval").click()
        await expect(page.get_by_test_id("onboard")).to_contain_text("no mission. Changed")
        await approved(drone)
        await expect(page.get_by_test_id("onboard")).to_have_text("On the vehicle: 1 item.")
        # What was approved is not run where the vehicle has another mission by then.
        async with held(page.get_by_role("button", name="Run the mission")):
            await expect(page.get_by_test_id("kept")).to_have_text("null")
        await page.get_by_role("button", name="Ask for approval").click()
        items = [{"command": "NAV_WAYPOINT", "latitude": -35.363, "longitude": 149.1653}]
        await execute(drone, f"{DRONE}/action/mission/upload", {"items": items})
        await approved(drone)
        await expect(page.get_by_test_id("refusal")).to_contain_text("than was shown")
    await execute(drone, f"{DRONE}/service/mission/clear")


async def approved(robot: httpx.AsyncClient) -> None:
    """Approve whatever waits."""
    ada = {"authorization": f"Bearer {key_of('ada')}"}
    asked = (await robot.get("/rcp/v1/context/system/approvals", headers=ada)).json()["body"]
    [waiting] = [one["approval"] for one in asked if one["status"] == "pending"]
    decision = {"id": waiting, "decision": "approve"}
    await robot.post("/rcp/v1/context/system/approvals", json=decision, headers=ada)


async def test_a_goal_is_not_sent_with_an_altitude_that_is_no_number(
    browser: Browser, url: str
) -> None:
    async with opened(browser, url) as tab:
        page = tab.page
        height = page.get_by_label("Altitude of the goal")
        await height.press_sequentially("-")
        await expect(height).to_have_attribute("aria-invalid", "true")
        await page.get_by_test_id("aim").click()
        await page.get_by_test_id("map").focus()
        await page.keyboard.press("Enter")
        await expect(page.get_by_test_id("refusal")).to_contain_text("altitude of the goal is no")
        await expect(page.get_by_test_id("goal-status")).to_have_text("Not sent")


async def test_heights_typed_in_feet_arrive_in_metres(
    browser: Browser, url: str, drone: httpx.AsyncClient
) -> None:
    imperial = "localStorage.setItem('rcp.units', 'imperial')"
    async with opened(browser, url, imperial) as tab:
        page = tab.page
        await execute(drone, f"{DRONE}/service/mission/clear")
        height = page.get_by_label("Altitude of the goal in ft above home")
        await height.fill("100")
        await page.get_by_test_id("aim").click()
        await page.get_by_test_id("map").focus()
        await page.keyboard.press("Enter")
        await expect(page.get_by_test_id("goal-status")).to_be_visible()
        commands = (await drone.get("/rcp/v1/context/system/commands")).json()["body"]
        inputs = [one.get("input") or {} for one in commands]
        assert 30.48 in [one.get("altitude") for one in inputs], commands
        drawn = await planning(page)
        await page.get_by_label("Height of new waypoints in ft above home").fill("50")
        await drawn.click((100, 0))
        await expect(page.get_by_label("Altitude of item 1")).to_have_value("50")
        await page.get_by_test_id("upload").click()
        await expect(page.get_by_test_id("onboard")).to_have_text("On the vehicle: 1 item.")
        stored = (await execute(drone, f"{DRONE}/service/mission/download"))["items"]
        assert [one["altitude"] for one in stored] == [pytest.approx(15.24, abs=0.01)]
    await execute(drone, f"{DRONE}/service/mission/clear")


async def test_a_mission_is_made_without_a_pointer_and_suits_those_who_see_otherwise(
    browser: Browser, url: str, axe: str
) -> None:
    async with opened(browser, url) as tab:
        page = tab.page
        await page.get_by_test_id("plan").focus()
        await page.keyboard.press("Enter")
        await expect(page.get_by_test_id("onboard")).to_contain_text("On the vehicle")
        if await page.get_by_role("button", name="Discard").count():
            await page.get_by_role("button", name="Discard").press("Enter")
        await page.get_by_test_id("draw").press("Enter")
        before = await items(page).filter(has=page.get_by_role("button")).count()
        await page.get_by_test_id("map").focus()
        for pressed in ("Enter", "ArrowRight", "Enter", "ArrowUp", "Enter"):
            await page.keyboard.press(pressed)
        await expect(items(page)).to_have_count(before + 3)
        await page.get_by_role("button", name=f"Move item {before + 3} up").press("Enter")
        await page.get_by_test_id("map").focus()
        await page.keyboard.press("Delete")
        await expect(items(page)).to_have_count(before + 2)
        await page.get_by_role("button", name="Undo").press("Enter")
        await expect(items(page)).to_have_count(before + 3)
        await page.evaluate(axe)
        assert await violations(page, RULES) == []
        assert not await scrolls_sideways(page)
        await page.set_viewport_size({"width": 390, "height": 844})
        await expect(items(page)).to_have_count(before + 3)
        assert await violations(page, RULES) == []
        assert not await scrolls_sideways(page)
        assert await page.evaluate(SMALL) == []
        await tab.shoot("map-phone")


async def test_nothing_is_uploaded_or_flown_from_a_layout_that_is_edited(
    browser: Browser, url: str, drone: httpx.AsyncClient
) -> None:
    layout = {"columns": [{"panels": [{"kind": "map", "robot": "drone"}]}]}
    await execute(drone, OWN, {"do": "save", "name": "Flight", "content": layout})
    async with opened(browser, url) as tab:
        page = tab.page
        await tab.open("layout/otto/Flight")
        drawn = await planning(page)
        await drawn.click((30, 30))
        await expect(page.get_by_test_id("upload")).to_be_enabled()
        count = await items(page).count()
        await page.get_by_role("button", name="Edit").click()
        await expect(page.get_by_test_id("upload")).to_be_disabled()
        await expect(page.get_by_test_id("draw")).to_be_disabled()
        box = await page.get_by_test_id("map").bounding_box()
        await Drawn(page, box).click((-60, -30))
        await expect(items(page)).to_have_count(count)
