"""The dashboard with very much of everything: it draws all the time, and asks only for what is looked at."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager, suppress

import pytest
from playwright.async_api import Browser, Page, expect

from browser.watched import log_in, watched
from browser.worlds import KEY, live, world
from rcp_kernel.model import Resource
from rcp_kernel.types import Point, PoseStamped

pytestmark = [pytest.mark.anyio, pytest.mark.serial]
expect.set_options(timeout=60_000)  # ms
ROBOTS = 300
PATHS = 5000
EVENTS = 2000  # a second
LONGEST = 1500  # ms of a frame, on a machine that does other things as well
_FRAMES = """
(count) => new Promise((done) => {
  let [longest, last] = [0, performance.now()];
  const next = () => {
    const now = performance.now();
    longest = Math.max(longest, now - last);
    last = now;
    if (--count > 0) requestAnimationFrame(next);
    else done(longest);
  };
  requestAnimationFrame(next);
})
"""


async def longest(page: Page, frames: int = 60) -> float:
    """Return the ms of the longest of the next frames."""
    found: float = await page.evaluate(_FRAMES, frames)
    return found


@asynccontextmanager
async def going(tell: Callable[[], None], every: float) -> AsyncGenerator[None]:
    """Do something again and again while entered."""

    async def run() -> None:
        while True:
            begun = time.monotonic()
            tell()
            await asyncio.sleep(max(0.005, begun + every - time.monotonic()))

    task = asyncio.create_task(run())
    try:
        yield
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def test_hundreds_of_robots_are_looked_over(browser: Browser) -> None:
    pose = Resource(name="sensor/pose", description="Where.", value=PoseStamped, live=True)
    has = [pose, live("sensor/battery"), live("sensor/mode"), live("event/fault")]
    robots = {f"robot-{at:03}": (f"t{at:03}", has) for at in range(ROBOTS)}
    async with world(robots) as gateway, watched(browser, gateway.url) as tab:
        page = tab.page
        numbers = itertools.count()

        def tell() -> None:
            number = next(numbers)
            for name in robots:
                gateway.publish(name, "sensor/pose", PoseStamped(Point(number, 0)))
                gateway.publish(name, "sensor/mode", "AUTO")

        await tab.open()
        await log_in(page, KEY)
        await expect(page.locator("[data-robot]")).to_have_count(ROBOTS)
        async with going(tell, 0.5):
            await expect(page.locator('[data-robot="robot-000"]')).to_contain_text("AUTO")
            assert await longest(page) < LONGEST
            last = page.locator(f'[data-robot="robot-{ROBOTS - 1}"]')
            await expect(last).not_to_contain_text(", 0.00 m")  # nobody looks at it
            known = gateway.served.server.gateway.sessions.known.values()
            assert sum(len(one.subscriptions) for one in known) < ROBOTS / 2
            await last.scroll_into_view_if_needed()
            await expect(last).to_contain_text(", 0.00 m")
            assert await longest(page) < LONGEST


async def test_thousands_of_paths_are_searched_and_opened_bit_by_bit(browser: Browser) -> None:
    has = [live(f"sensor/row{at // 100}/value{at}") for at in range(PATHS)]
    async with world({"plant": ("alpha", has)}) as gateway, watched(browser, gateway.url) as tab:
        rows = tab.page.locator("[data-path]")
        await tab.open("explore")
        await log_in(tab.page, KEY)
        await tab.page.get_by_role("button", name=f"Show 200 more of {PATHS}").click()
        await expect(rows).to_have_count(400)
        search = tab.page.get_by_role("searchbox", name="Search")
        drawn = asyncio.ensure_future(longest(tab.page, 90))
        await search.press_sequentially("value4999")
        await expect(rows).to_have_count(1)
        assert await drawn < LONGEST
        await search.fill("")
        await tab.open("explore?path=/tenant/alpha/sensor/row9/value999")
        await expect(tab.page.locator('[aria-current="true"]')).to_be_visible()


async def test_thousands_of_alarms_a_second_leave_the_page_in_hand(browser: Browser) -> None:
    has = [live("event/fault"), live("event/note")]
    async with world({"plant": ("alpha", has)}) as gateway, watched(browser, gateway.url) as tab:
        page = tab.page
        numbers = itertools.count()

        def tell() -> None:
            for number in itertools.islice(numbers, EVENTS // 50):
                told = {"message": f"no {number}", "severity": "warning", "active": True}
                name = "event/fault" if number % 2 else "event/note"
                gateway.publish("plant", name, told | {"fault": f"f{number}"})

        await tab.open()
        await log_in(page, KEY)
        await expect(page.locator('[data-robot="plant"]')).to_contain_text("ready")
        async with going(tell, 0.02):
            more = page.locator('[data-robot="plant"]').get_by_role("link", name="more")
            await expect(more).to_contain_text("194")  # as many as are known at once
            assert await longest(page) < LONGEST
            await tab.open("log")
            await expect(page.get_by_text("show all").first).to_be_visible()
            assert await longest(page) < LONGEST
