"""The dashboard's time line: pages that show what was, nothing that moves meanwhile, and recordings."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader
from playwright.async_api import Browser, Locator, Page, expect

import rcp_recorder
from browser.accessible import SMALL, scrolls_sideways, violations
from browser.watched import Watched, signed_in
from configuration import backend, key, listener, role, rule, table
from rcp_gateway.log import configure
from rcp_gateway.testing import ScriptedRobot, scripted, serve
from rcp_kernel.clock import iso, now
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host
from rcp_kernel.types import Point, PoseStamped, quantity

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
(KIND,) = rcp_recorder.rcp_features()
ADMIN, VIEWER = "admin-who-looks-back", "viewer-who-looks-back"
POSE, SPEED = "/tenant/alpha/sensor/pose", "/tenant/alpha/sensor/speed"
BOUND = 60.0  # s
EDGE = 3_000_000_000  # ns: the page looks at nothing newer than 2 s, by its estimate of the clock
RED, GREEN = (255, 0, 0), (0, 128, 0)
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
Speed = quantity("m/s")


class Fix(msgspec.Struct):
    """Where it is on the earth."""

    latitude: float
    longitude: float


class Picture(msgspec.Struct):
    """An image of one colour."""

    width: int
    height: int
    encoding: str
    step: int
    data: bytes


class Fault(msgspec.Struct):
    """What went wrong."""

    text: str


def painted(colour: tuple[int, int, int]) -> Picture:
    return Picture(4, 4, "rgb8", 12, bytes(colour) * 16)


def _robot(host: Host) -> ScriptedRobot:
    made = ScriptedRobot(
        host,
        Resource(name="sensor/pose", description="The pose.", value=PoseStamped),
        Resource(name="sensor/speed", description="The speed.", value=Speed),
        Resource(name="sensor/position/global", description="The place.", value=Fix),
        Resource(name="sensor/camera", description="The camera.", value=Picture),
        Resource(name="event/fault", description="Faults.", value=Fault),
        Resource(name="actuator/drive", description="The drive.", value=Speed),
        Resource(name="param/limit", description="The limit.", value=Speed),
        values={"param/limit": 3.0},
    )
    made.release.set()
    return made


class Rig:
    """The gateway, its robot, and the list of its recordings."""

    def __init__(self, url: str, robot: ScriptedRobot, client: Any) -> None:
        self.url = url
        self.robot = robot
        self._client = client
        self.count = 0

    def tell(self, number: int, colour: tuple[int, int, int]) -> int:
        """Have the robot tell of everything once, and return the moment after it in ns."""
        robot = self.robot
        robot.measure("sensor/pose", PoseStamped(position=Point(x=float(number), y=0.0)))
        robot.measure("sensor/speed", float(number))
        robot.measure("sensor/position/global", Fix(50.0 + number, 10.0))
        robot.measure("sensor/camera", painted(colour))
        robot.host.publish("event/fault", Fault(f"fault {number}"))
        self.count += 5
        return now() + 5_000_000

    async def recordings(self) -> list[dict[str, Any]]:
        reply = await self._client.request("read", "/system/recorder")
        found: list[dict[str, Any]] = reply["body"]
        return found

    async def until(self, wanted: Any) -> None:
        async with asyncio.timeout(BOUND):
            while True:
                if wanted(await self.recordings()):
                    return
                await asyncio.sleep(0.05)

    async def written(self) -> None:
        """Wait until all of it is on the disk."""
        await self.until(lambda all_: sum(one["messages"] for one in all_) >= self.count)


@asynccontextmanager
async def rig(folder: Path) -> AsyncGenerator[Rig]:
    """Run a gateway that records its robot."""
    configure("error", "json")
    tables = (
        listener(),
        table("plugins.dashboard"),
        backend("rover"),
        key("admin", ADMIN, role="admin"),
        role(
            "watcher",
            rule("discover read subscribe", "/**"),
            rule("discover read subscribe", "/system/recorder"),
        ),
        key("viewer", VIEWER, role="watcher"),
        table("features.recorder", folder=folder, free_mb=0, paths=["/tenant/**"]),
        table("features.recorder.black_box", seconds=5, after=0.2),
    )
    async with serve(parse("".join(tables), "test"), scripted(_robot), features=(KIND,)) as served:
        url = next(f["url"] for f in served.server.status.transports if "url" in f)
        robot = served.life.backend
        assert isinstance(robot, ScriptedRobot)
        yield Rig(url, robot, served.client(ADMIN))


@asynccontextmanager
async def two_moments(folder: Path, browser: Browser) -> AsyncGenerator[tuple[Rig, Watched, str]]:
    """Record something, then something else; open the dashboard with the moment between them."""
    async with rig(folder) as found:
        between = found.tell(1, RED)
        await found.written()
        assert now() > between
        found.tell(2, GREEN)
        await found.written()
        async with signed_in(browser, found.url, ADMIN, "admin") as tab:
            tab.expected.append("willReadFrequently")  # of looking at the canvas here
            while now() < between + EDGE:  # noqa: ASYNC110 - a link to what is newer leads before it
                await asyncio.sleep(0.05)
            yield found, tab, iso(between)


async def colour(page: Page) -> list[int]:
    found: list[int] = (
        await page.get_by_test_id("camera")
        .locator("canvas")
        .first.evaluate(
            "(one) => [...one.getContext('2d').getImageData(1, 1, 1, 1).data].slice(0, 3)"
        )
    )
    return found


async def shows(page: Page, wanted: tuple[int, int, int]) -> None:
    """Wait until the camera shows a colour."""
    async with asyncio.timeout(BOUND):
        while True:
            if await colour(page) == list(wanted):
                return
            await asyncio.sleep(0.05)


def band(page: Page) -> Locator:
    return page.get_by_test_id("past")


async def back_to_live(page: Page) -> None:
    await page.get_by_role("button", name="Back to live").click()
    await expect(band(page)).to_have_count(0)


async def test_pages_show_a_moment_in_the_past_and_the_present_again(
    tmp_path: Path, browser: Browser
) -> None:
    async with two_moments(tmp_path, browser) as (_, tab, between):
        page = tab.page
        await tab.open(f"camera?at={between}&robot=/tenant/alpha")
        await expect(band(page)).to_be_visible()
        await shows(page, RED)
        await expect(page.get_by_test_id("camera")).to_have_attribute("data-stale", "false")
        await tab.shoot("past-camera")
        await page.get_by_role("link", name="Map").click()
        await expect(page.locator(".list")).to_contain_text("51.000000°")
        await page.get_by_role("link", name="Log").click()
        await expect(page.locator(".filters")).to_contain_text("Robot rover")
        await expect(page.locator("main")).to_contain_text("fault 1")
        await expect(page.locator("main")).not_to_contain_text("fault 2")
        await expect(page).to_have_url(re.compile("at=.*robot="))
        await tab.open(f"explore?at={between}&path={SPEED}")
        await expect(page.get_by_test_id("value")).to_contain_text("1")
        await tab.open(f"plot?at={between}&p={SPEED}%23&span=300")
        await expect(page.get_by_test_id("shown")).to_contain_text("1.0000")
        await back_to_live(page)
        await expect(page.get_by_test_id("shown")).to_contain_text("2.0000")
        await expect(page).not_to_have_url(re.compile("at="))
        await page.get_by_role("link", name="Log").click()
        await expect(page.locator("main")).to_contain_text("fault 2")
        await tab.open("camera")
        await shows(page, GREEN)


async def test_what_was_is_played_up_to_what_followed(tmp_path: Path, browser: Browser) -> None:
    async with two_moments(tmp_path, browser) as (_, tab, between):
        page = tab.page
        await tab.open(f"explore?at={between}&path={SPEED}")
        value = page.get_by_test_id("value")
        await expect(value).to_contain_text("1")
        await page.get_by_label("Speed", exact=True).select_option("10")
        await page.get_by_test_id("play").click()
        await expect(value).to_contain_text("2")
        await expect(page.get_by_test_id("play")).to_contain_text("Play")  # there is no more
        slider = page.get_by_role("slider", name="Moment")
        await slider.focus()
        before = await page.get_by_test_id("moment").inner_text()
        for _ in range(30):
            await page.keyboard.press("ArrowLeft")
        await expect(page.get_by_test_id("moment")).not_to_have_text(before)
        await expect(page.locator("main")).to_contain_text("nothing was recorded yet")


async def test_nothing_moves_a_robot_while_one_looks_at_the_past_but_stops_stop(
    tmp_path: Path, browser: Browser
) -> None:
    async with two_moments(tmp_path, browser) as (found, tab, between):
        page, robot = tab.page, found.robot
        await tab.open(f"explore?at={between}&path=/tenant/alpha/actuator/drive")
        form = page.get_by_test_id("ask-write")
        write = form.get_by_role("button", name="Write", exact=True)
        await expect(write).to_be_disabled()
        await form.get_by_label("value").fill("1")
        await page.keyboard.press("Enter")
        await expect(form).to_contain_text("Press Back to live")
        await page.get_by_role("link", name="Teleop").click()
        await expect(page.get_by_role("main")).to_contain_text("Press Back to live to drive")
        await page.get_by_role("link", name="Parameters").click()
        await expect(page.get_by_label("Value of limit")).to_have_value("3")
        await expect(page.get_by_label("Value of limit")).to_have_attribute("readonly", "")
        await expect(page.get_by_text("These are the present values")).to_be_visible()
        assert robot.writes == []
        await page.keyboard.press("F9")
        await expect(page.get_by_test_id("estop-active")).to_be_visible()
        assert robot.halts >= 1
        await page.get_by_test_id("estop-reset").click()
        await expect(page.get_by_test_id("estop-active")).to_have_count(0)
        await back_to_live(page)
        await page.get_by_role("link", name="Explore").click()
        await tab.open("explore?path=/tenant/alpha/actuator/drive")
        await form.get_by_label("value").fill("1")
        await write.click()
        await expect(page.get_by_test_id("answer")).to_contain_text("completed")
        assert robot.writes == [("actuator/drive", 1.0)]


async def test_an_incident_is_found_on_the_time_line(tmp_path: Path, browser: Browser) -> None:
    async with two_moments(tmp_path, browser) as (found, tab, _):
        page = tab.page
        await page.keyboard.press("F9")
        await expect(page.get_by_test_id("estop-active")).to_be_visible()
        await page.get_by_test_id("estop-reset").click()
        await found.until(
            lambda all_: [o for o in all_ if o["name"] == "incident" and o["state"] == "kept"]
        )
        await tab.open("log")
        mark = page.get_by_role("button", name=re.compile("^Incident: e-stop"))
        await expect(mark).to_have_count(1)
        await page.get_by_role("button", name="Last incident").click()
        await expect(band(page)).to_be_visible()
        await tab.open("recordings")
        row = page.get_by_role("region", name="Incidents").locator("tbody tr")
        await expect(row).to_contain_text("e-stop by admin")
        await row.get_by_role("link", name="Look").click()
        await expect(page.get_by_role("main", name="Scene")).to_be_visible()
        await expect(page.get_by_label("Robot", exact=True)).to_have_value("rover")


async def test_recordings_are_started_stopped_pinned_and_downloaded(
    tmp_path: Path, browser: Browser
) -> None:
    async with two_moments(tmp_path, browser) as (found, tab, _):
        page = tab.page
        await tab.open("recordings")
        form = page.get_by_role("form", name="Start a recording")
        await form.get_by_label("Name").fill("Test Drive")
        await expect(form.get_by_role("alert")).to_contain_text("small letters")
        await form.get_by_label("Name").fill("test-drive")
        await page.keyboard.press("Enter")
        found.robot.measure("sensor/speed", 3.0)
        row = page.locator("tr", has_text="test-drive")
        await expect(row).to_contain_text("recording")
        await row.get_by_role("button", name="Stop").click()
        await expect(row).to_contain_text("kept")
        await row.get_by_role("button", name="Pin").click()
        await expect(row).to_contain_text("pinned")
        await tab.shoot("recordings")
        async with page.expect_download() as coming:
            await row.get_by_role("button", name="Download").click()
        path = await (await coming.value).path()
        with path.open("rb") as file:
            topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
        assert SPEED in topics
        await row.get_by_role("button", name="Unpin").click()
        await expect(row).not_to_contain_text("pinned")
        async with signed_in(browser, found.url, VIEWER, "viewer") as other:
            await other.open("recordings")
            seen = other.page.locator("tr", has_text="test-drive")
            await expect(seen.get_by_role("button", name="Download")).to_be_visible()
            await expect(seen.get_by_role("button", name="Unpin")).to_have_count(0)
            await expect(seen.get_by_role("button", name="Pin")).to_have_count(0)
            await expect(other.page.get_by_role("form")).to_have_count(0)


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (1024, 768), (390, 844)])
async def test_the_time_line_is_for_everybody_and_every_screen(
    tmp_path: Path, browser: Browser, axe: str, width: int, height: int
) -> None:
    async with two_moments(tmp_path, browser) as (found, tab, between):
        page = tab.page
        await page.set_viewport_size({"width": width, "height": height})
        await page.evaluate(axe)
        wrong: list[str] = []
        for name in (
            f"camera?at={between}",
            f"plot?p={SPEED}%23",
            f"log?at={between}",
            "recordings",
        ):
            await tab.open(name)
            await expect(page.locator("main")).not_to_contain_text("Loading")
            wrong += [f"{name}: {one}" for one in await violations(page, RULES)]
            assert not await scrolls_sideways(page), f"{name} has to be scrolled sideways"
            if width < 900:
                assert not (small := await page.evaluate(SMALL)), f"{name}: {small}"
            await expect(page.get_by_test_id("estop")).to_be_in_viewport(ratio=1)
            await expect(page.get_by_role("button", name="Back to live")).to_be_in_viewport(ratio=1)
        assert not wrong, "\n".join(wrong)
        assert found.robot.writes == []


async def test_where_nothing_is_recorded_there_is_no_time_line_and_a_link_says_so(
    browser: Browser,
) -> None:
    configure("error", "json")
    tables = (listener(), table("plugins.dashboard"), backend("rover"), key("admin", ADMIN))
    async with serve(parse("".join(tables), "test"), scripted(_robot)) as served:
        url = next(f["url"] for f in served.server.status.transports if "url" in f)
        async with signed_in(browser, url, ADMIN, "admin") as tab:
            await tab.open("log")
            await expect(tab.page.get_by_role("main", name="Log")).to_be_visible()
            await expect(tab.page.get_by_test_id("timeline")).to_have_count(0)
            links = tab.page.get_by_role("navigation", name="Pages").get_by_role("link")
            await expect(links.filter(has_text="Recordings")).to_have_count(0)
            await tab.open("people?at=2026-11-24T15:00:00Z")
            await expect(band(tab.page)).to_contain_text("Nothing is recorded")
            await back_to_live(tab.page)
