"""Plots under fingers: one moves the time, two stretch it, and what lies under a finger stays there."""

from __future__ import annotations

import asyncio

import pytest
from playwright.async_api import Browser, Page, expect

from browser.input_helpers import touching
from browser.machines import key_of, machines
from browser.watched import signed_in

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
_POSE = "/tenant/alpha/sensor/pose%23position.x"
_BOUND = 60.0  # s
_NEAR = 0.15  # s: less than two pixels


async def shown(page: Page) -> tuple[float, float]:
    """Return the begin and end of the time that is shown."""
    status_text = await page.get_by_test_id("chart").get_attribute("data-range")
    assert status_text is not None
    begin, end = map(float, status_text.split())
    return begin, end


async def becomes(page: Page, begin: float, end: float) -> None:
    """Wait until this is shown: a browser tells of moves once in a frame."""
    found = begin, end
    try:
        async with asyncio.timeout(_BOUND):
            while True:
                found = await shown(page)
                if max(abs(found[0] - begin), abs(found[1] - end)) < _NEAR:
                    return
                await asyncio.sleep(0.02)
    except TimeoutError:
        pytest.fail(f"it shows {found[0] - begin:+.2f} … {found[1] - end:+.2f} s beside that")


async def test_one_finger_moves_a_plot_and_two_stretch_it(browser: Browser) -> None:
    async with (
        machines() as running,
        signed_in(browser, running.url, key_of("otto"), "otto") as tab,
    ):
        page = tab.page
        await tab.open(f"plot?p={_POSE}&span=10")
        await expect(page.get_by_test_id("shown")).to_contain_text("m")
        await page.get_by_test_id("pause").click()
        await expect(page.get_by_test_id("chart")).not_to_have_attribute("data-range", "live")
        box = await page.locator(".u-over").bounding_box()
        assert box is not None

        def at(part: float, *, low: bool = False) -> tuple[float, float]:
            return box["x"] + part * box["width"], box["y"] + box["height"] * (0.7 if low else 0.4)

        begin, end = await shown(page)
        async with touching(page) as touch:
            await touch.down(0, *at(0.2))
            for step in range(1, 9):  # quicker than it is drawn
                await touch.move(a=at(0.2 + 0.05 * step))
            await touch.up(0)
            await becomes(page, begin - 4, end - 4)
            begin, end = await shown(page)
            await touch.down(0, *at(0.4))
            await touch.down(1, *at(0.6, low=True))
            for step in range(1, 5):
                await touch.move(a=at(0.4 - 0.05 * step), b=at(0.6 + 0.05 * step, low=True))
            await becomes(page, begin + 10 / 3, end - 10 / 3)
            for step in range(1, 4):  # both to the right
                await touch.move(a=at(0.2 + 0.05 * step), b=at(0.8 + 0.05 * step, low=True))
            moved = 0.15 * 10 / 3
            await becomes(page, begin + 10 / 3 - moved, end - 10 / 3 - moved)
            await touch.up(1)  # the other one goes on, without a jump
            await touch.move(a=at(0.35))
            await becomes(page, begin + 10 / 3 - moved, end - 10 / 3 - moved)
            await touch.move(a=at(0.05))
            await touch.up(0)
            moved -= 0.3 * 10 / 3
            await becomes(page, begin + 10 / 3 - moved, end - 10 / 3 - moved)
        await tab.shoot("plot-touched")
