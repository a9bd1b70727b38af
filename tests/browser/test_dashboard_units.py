"""Plots, values and joints in the units that a person chose: on the wire, in links and in tables all stay metric."""

from __future__ import annotations

import asyncio
import csv
import re
from collections.abc import AsyncGenerator
from typing import Annotated, Any

import msgspec
import pytest
from playwright.async_api import Browser, Page, expect

from browser.watched import Watched, signed_in
from browser.worlds import KEY, World, world
from rcp_kernel.model import Resource

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
IMPERIAL = "localStorage.setItem('rcp.units', 'imperial')"
LIFT = "/tenant/alpha/actuator/lift"
RANGE = "/tenant/alpha/sensor/range"
Metres = Annotated[float, msgspec.Meta(extra_json_schema={"unit": "m"})]
Warmth = Annotated[float, msgspec.Meta(extra_json_schema={"unit": "Cel"})]
Travel = Annotated[float, msgspec.Meta(ge=0, le=0.3, extra_json_schema={"unit": "m"})]


class Measured(msgspec.Struct):
    """What a range finder tells."""

    distance: Metres
    warmth: Warmth


class Height(msgspec.Struct):
    """Where a lift is."""

    position: Metres


ROBOTS = {
    "lifter": (
        "alpha",
        [
            Resource(name="sensor/range", description="How far.", value=Measured, live=True),
            Resource(
                name="sensor/lift", description="How high.", value=Height, live=True, deadline=60
            ),
            Resource(name="actuator/lift", description="Lifts.", value=Travel, live=True),
        ],
    )
}


@pytest.fixture(scope="module")
async def lifter() -> AsyncGenerator[World]:
    async with world(ROBOTS) as made:
        yield made


@pytest.fixture
async def tab(browser: Browser, lifter: World) -> AsyncGenerator[Watched]:
    async with signed_in(browser, lifter.url, KEY, "wall", IMPERIAL) as found:
        tell(lifter)
        yield found


def tell(lifter: World) -> None:
    lifter.publish("lifter", "sensor/range", {"distance": 3.048, "warmth": 100.0})
    lifter.publish("lifter", "sensor/lift", {"position": 0.1})


async def test_explore_shows_feet_and_json_what_the_robot_told(tab: Watched) -> None:
    page = tab.page
    await tab.open(f"explore?path={RANGE}")
    value = page.get_by_test_id("value")
    await expect(value).to_contain_text(re.compile(r"distance\s*10(\.0000)?\s*ft"))
    await expect(value).to_contain_text(re.compile(r"warmth\s*212(\.0000)?\s*°F"))
    await expect(page.locator(f'[data-path="{RANGE}"]')).to_contain_text("distance 10")
    await page.get_by_role("button", name="JSON").click()
    await expect(value).to_contain_text("3.048")


async def test_a_plot_is_in_feet_its_link_and_its_table_in_metres(
    tab: Watched, lifter: World
) -> None:
    page = tab.page
    await tab.open(f"plot?p={RANGE}%23distance&span=60")
    shown = page.get_by_test_id("shown")
    await expect(shown).to_have_text("10.0000 ft")
    await page.get_by_title("Axis range").click()
    await page.get_by_label("Minimum (ft)").fill("0")
    await page.get_by_label("Maximum (ft)").fill("100")
    await page.get_by_role("button", name="Set").click()
    await expect(page.get_by_title("Axis range")).to_have_text("↕ 0 … 100")
    await expect(page).to_have_url(re.compile(re.escape("y%3D0..30.48")))
    await expect(page.get_by_text("CSV in metric units")).to_be_visible()
    assert (await table(page))[-1] == {f"{RANGE} distance [m]": "3.048"}
    await page.get_by_label("What is drawn of distance").select_option("rate")
    tell(lifter)
    await expect(shown).to_have_text("0.0000 mph")


async def table(page: Page) -> list[dict[str, str]]:
    """Save what is shown, and read its columns beside the time."""
    async with page.expect_download() as found:
        await page.get_by_role("button", name="CSV").click()
    with (await (await found.value).path()).open() as file:
        return [{k: v for k, v in row.items() if k != "time"} for row in csv.DictReader(file)]


async def test_a_joint_goes_where_it_was_told_to_in_feet(tab: Watched, lifter: World) -> None:
    page = tab.page
    await tab.open("teleop?robot=lifter")
    await page.get_by_role("button", name="Take control").click()
    await expect(page.get_by_test_id("control")).to_contain_text("You have control")
    lift = page.locator("[data-joints]")
    await expect(lift.get_by_title("Measured")).to_have_text("is 0.328")
    goal = lift.get_by_label("Target of lift in ft")
    await goal.fill("2")
    await expect(goal).to_have_attribute("aria-invalid", "true")
    await goal.fill("0.5")
    await lift.get_by_role("button", name="Go").click()
    writes = lifter.robots["lifter"].writes
    await written(writes, 1)
    await lift.get_by_label(re.compile("^Step")).select_option(label="0.1 ft")
    await lift.get_by_label("lift plus 0.1 ft").click()  # from where it was measured
    await written(writes, 2)
    assert writes == [
        ("actuator/lift", 0.1524),
        ("actuator/lift", pytest.approx(0.1 + 0.03048)),
    ]


async def written(writes: list[tuple[str, Any]], count: int) -> None:
    """Wait until so many values were written."""
    async with asyncio.timeout(60):
        while len(writes) < count:  # noqa: ASYNC110 - the robot only lists them
            await asyncio.sleep(0.02)
