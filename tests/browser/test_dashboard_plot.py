"""Plots of the dashboard: one subscription for a path, what was before, zoom, the cursor, tables."""

from __future__ import annotations

import asyncio
import csv
import json
import re
import time
from datetime import datetime
from typing import Any

import pytest
from playwright.async_api import Page, WebSocket, expect

from browser.watched import Watched

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
IMU = "/tenant/alpha/sensor/imu"
ACCELERATION = f"{IMU}%23linear_acceleration"
BEFORE = 4.0  # s of what was plotted before the page is loaded anew
BOUND = 60.0  # s


async def table(page: Page) -> list[dict[str, str]]:
    """Save what is shown, and read it."""
    async with page.expect_download() as found:
        await page.get_by_role("button", name="CSV").click()
    download = await found.value
    assert re.fullmatch(r"rcp-[\dT-]+\.csv", download.suggested_filename)
    path = await download.path()
    with path.open() as file:
        return list(csv.DictReader(file))


def moment(row: dict[str, str]) -> float:
    return datetime.fromisoformat(row["time"]).timestamp()


async def test_plots_of_one_path_share_one_subscription(tab: Watched) -> None:
    requests: list[dict[str, Any]] = []

    def sent(payload: str | bytes) -> None:
        requests.append(json.loads(payload))

    def opened(socket: WebSocket) -> None:
        socket.on("framesent", sent)

    tab.page.on("websocket", opened)
    await tab.open(f"plot?p={ACCELERATION}.x,{ACCELERATION}.y&p={ACCELERATION}.z&span=10")
    await tab.page.reload()
    shown = tab.page.get_by_test_id("shown")
    await expect(shown).to_have_count(3)
    for at in range(3):
        await expect(shown.nth(at)).to_have_text(re.compile(r"-?\d+\.\d+ m/s"))
    made = [one for one in requests if one["type"] == "subscribe" and IMU in str(one)]
    assert len(made) == 1, made


async def test_what_was_plotted_before_is_there_after_a_reload_and_saved_as_a_table(
    tab: Watched,
) -> None:
    await tab.open(f"plot?p={ACCELERATION}.x,{ACCELERATION}.z&span=30")
    column = f"{IMU} linear_acceleration.z [m/s2]"
    async with asyncio.timeout(BOUND):
        while True:
            rows = await table(tab.page)
            if rows and moment(rows[-1]) - moment(rows[0]) > BEFORE:
                break
            await asyncio.sleep(0.5)
    assert 5 < float(rows[-1][column]) < 15
    reloaded = time.time()
    await tab.page.reload()
    await expect(tab.page.get_by_test_id("shown").first).to_contain_text("m/s")
    async with asyncio.timeout(BOUND):
        while True:
            rows = await table(tab.page)
            if rows and moment(rows[0]) < reloaded - BEFORE / 2:
                break
            await asyncio.sleep(0.2)


async def test_a_stretch_is_zoomed_read_by_the_cursor_and_left_again(tab: Watched) -> None:
    page = tab.page
    await tab.open(
        f"plot?p={ACCELERATION}.z&p=/tenant/beta/sensor/imu%23linear_acceleration.z&span=10"
    )
    chart, shown = page.get_by_test_id("chart"), page.get_by_test_id("shown")
    await expect(shown.nth(1)).to_contain_text("m/s")
    await expect(chart.first).to_have_attribute("data-range", "live")
    box = await chart.first.locator(".u-over").bounding_box()
    assert box is not None
    middle = box["y"] + box["height"] / 2
    await page.mouse.move(box["x"] + box["width"] * 0.5, middle)
    await page.mouse.down()
    await page.mouse.move(box["x"] + box["width"] * 0.9, middle, steps=5)
    await page.mouse.up()
    await expect(page.get_by_test_id("pause")).to_have_attribute("aria-pressed", "true")
    first = await span(page, 0)
    assert 3 < first < 5  # 40 % of ten seconds
    assert await span(page, 1) == first  # the other plot shows the same time
    await expect(chart.first).to_contain_text(re.compile(r"at \d\d:\d\d:\d\d\.\d{3}"))
    await page.mouse.wheel(0, -100)
    await expect(chart.first).not_to_have_attribute("data-range", re.compile("live"))
    async with asyncio.timeout(BOUND):
        while not await span(page, 0) < first - 0.1:  # noqa: ASYNC110
            await asyncio.sleep(0.05)
    await tab.shoot("plot-zoomed")
    await page.mouse.dblclick(box["x"] + box["width"] / 2, middle)
    await expect(chart.first).to_have_attribute("data-range", "live")


async def span(page: Page, at: int) -> float:
    found = await page.get_by_test_id("chart").nth(at).get_attribute("data-range")
    assert found is not None
    begin, end = map(float, found.split())
    return round(end - begin, 3)


async def test_the_height_is_fixed_and_kept_in_the_address(tab: Watched) -> None:
    page = tab.page
    await tab.open(f"plot?p={ACCELERATION}.z&span=10")
    await page.get_by_role("button", name="auto").click()
    await page.get_by_label("Minimum").fill("5")
    await page.get_by_label("Maximum").fill("3")
    await page.get_by_role("button", name="Set").click()
    await expect(page.get_by_role("alert")).to_contain_text("the smaller one first")
    await page.get_by_label("Maximum").fill("15")
    await page.get_by_role("button", name="Set").click()
    await expect(page.get_by_role("button", name="5 … 15")).to_be_visible()
    await page.reload()
    await expect(page.get_by_role("button", name="5 … 15")).to_be_visible()


async def test_a_number_on_explore_is_plotted_by_a_press_and_by_dragging(tab: Watched) -> None:
    page = tab.page
    chart = page.get_by_test_id("chart")
    await tab.open("explore?path=/tenant/alpha/sensor/battery")
    await page.get_by_role("link", name="Plot voltage").click()
    await expect(chart).to_have_count(1)
    await expect(page.get_by_test_id("shown")).to_have_text(re.compile(r"\d+\.\d+ V"))
    await tab.open("explore?path=/tenant/alpha/sensor/battery")
    plot = page.get_by_role("navigation", name="Pages").get_by_role("link", name="Plot")
    await page.get_by_role("link", name="Plot current").drag_to(plot)
    await expect(chart).to_have_count(2)  # those from before are kept


async def test_a_line_shows_its_rate_and_two_lines_are_drawn_over_each_other(tab: Watched) -> None:
    page = tab.page
    await tab.open(f"plot?p={ACCELERATION}.x,{ACCELERATION}.z&span=10")
    shown = page.get_by_test_id("shown")
    await expect(shown.first).to_contain_text("m/s²")
    await page.get_by_label("What is drawn of linear_acceleration.x").select_option("rate")
    await expect(shown.first).to_have_text(re.compile(r"-?\d+\.\d+ m/s³"))
    await expect(page).to_have_url(re.compile("acceleration.x(~|%7E)rate"))
    await page.get_by_label("What is drawn of linear_acceleration.z").select_option("mean 5")
    await expect(shown.last).to_have_text(re.compile(r"\d+\.\d+ m/s²$"))
    await page.get_by_role("button", name="XY").click()
    await expect(page.get_by_test_id("xy")).to_have_attribute(
        "data-points", re.compile(r"[1-9]\d+")
    )
    await page.get_by_role("button", name="Save", exact=True).click()
    await expect(page.get_by_text("kept", exact=True)).to_be_visible()
    await tab.open("plot")
    await page.reload()
    await page.get_by_role("button", name="Load").click()
    await expect(page.get_by_test_id("xy")).to_have_attribute(
        "data-points", re.compile(r"[1-9]\d+")
    )
    await expect(page.get_by_label("What is drawn of linear_acceleration.x")).to_have_value("rate")
