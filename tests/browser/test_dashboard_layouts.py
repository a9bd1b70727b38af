"""Layouts that people put together: kept, shared, by keyboard, and as safe as the page Teleop."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncGenerator, Callable
from typing import Any

import httpx
import pytest
from playwright.async_api import Browser, Locator, Page, expect

from browser.accessible import SMALL, scrolls_sideways, violations
from browser.machines import Machines, key_of, machines, person

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
BOUND = 60.0  # s
OWN, SHARED = "/system/layouts", "/system/shared_layouts"
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]
NOTE = {"columns": [{"panels": [{"kind": "note", "text": "# Shift\n**Mind** the [gate](#/map)."}]}]}
TWO = {
    "columns": [
        {"panels": [{"kind": "teleop", "robot": "one"}]},
        {"panels": [{"kind": "teleop", "robot": "two"}]},
    ]
}


@pytest.fixture(scope="module")
async def site() -> AsyncGenerator[Machines]:
    """Run a gateway with two machines for all tests of the file."""
    async with machines() as running:
        yield running


async def ask(site: Machines, who: str, path: str, **body: Any) -> dict[str, Any]:
    """Execute something past the page."""
    headers = {"authorization": f"Bearer {key_of(who)}"}
    async with httpx.AsyncClient(base_url=site.url, headers=headers, timeout=BOUND) as client:
        message = {"type": "execute", "path": path, "body": body}
        return (await client.post("/rcp/v1/messages", json=message)).json()


async def keep(site: Machines, name: str, content: Any, who: str = "otto") -> None:
    reply = await ask(site, who, OWN, do="save", name=name, content=content)
    assert reply["status"] == "completed", reply


async def until(found: Callable[[], bool]) -> None:
    """Wait for what a machine is told."""
    async with asyncio.timeout(BOUND):
        while True:
            if found():
                return
            await asyncio.sleep(0.02)


def panel(page: Page, name: str) -> Locator:
    return page.get_by_role("region", name=name, exact=True)


def speeds(got: list[tuple[str, Any]]) -> list[float]:
    return [value.linear.x for name, value in got if name == "actuator/cmd_vel"]


async def test_a_layout_is_made_by_keyboard_alone_and_kept(
    browser: Browser, site: Machines
) -> None:
    async with person(browser, site, "otto", "layout/new") as tab:
        page = tab.page
        kind = page.get_by_label("Panel to add")
        add = page.get_by_role("button", name="Add a panel")
        await kind.select_option("note")
        await add.press("Enter")
        settings = page.get_by_role("button", name="Settings of Note")
        await settings.focus()
        await page.keyboard.press("Enter")
        title = page.get_by_label("Title")
        await title.focus()
        await page.keyboard.type("Mind")
        await page.keyboard.press("Enter")
        await kind.select_option("value")
        await add.press("Enter")
        await page.get_by_role("button", name="Settings of Value").press("Enter")
        await page.get_by_label("Resource").fill("pose one")
        await page.keyboard.press("Enter")
        await expect(panel(page, "Value · sensor/pose")).to_contain_text("position")
        border = page.get_by_role("separator", name="Border between columns 1 and 2")
        await expect(border).to_have_attribute("aria-valuenow", "50")
        await border.focus()
        await page.keyboard.press("ArrowRight")
        await expect(border).to_have_attribute("aria-valuenow", "53")
        await page.get_by_role("button", name="Move Value · sensor/pose left").press("Enter")
        await expect(page.locator('[data-column="0"] section')).to_have_count(2)
        await page.get_by_role("button", name="Save as").press("Enter")
        await page.get_by_label("Name", exact=True).fill("Keys alone")
        await page.keyboard.press("Enter")
        await expect(page.get_by_role("heading", name="Keys alone")).to_be_visible()
        assert page.url.endswith("#/layout/otto/Keys%20alone")
        await page.reload()
        await expect(panel(page, "Value · sensor/pose")).to_contain_text("position")
        await expect(panel(page, "Mind")).to_be_visible()
        await tab.open("layout")
        await page.get_by_role("link", name="Keys alone").click()
        await expect(panel(page, "Mind")).to_be_visible()


async def test_who_saves_an_older_version_is_told_and_can_save_it_as_another(
    browser: Browser, site: Machines
) -> None:
    saved = await ask(site, "otto", SHARED, do="save", name="Day", tenant="alpha", content=NOTE)
    assert saved["status"] == "completed", saved
    async with person(browser, site, "otto", "layout/@alpha/Day") as tab:
        page = tab.page
        await expect(page.get_by_role("link", name="gate")).to_have_attribute("href", "#/map")
        await page.get_by_role("button", name="Edit").click()
        await page.get_by_label("Panel to add").select_option("commands")
        await page.get_by_role("button", name="Add a panel").click()
        await expect(page.get_by_test_id("layout-status")).to_have_text("Not saved.")
        later = {"columns": [{"panels": [{"kind": "note", "text": "ada was here"}]}]}
        save = {"do": "save", "name": "Day", "tenant": "alpha"}
        assert (await ask(site, "ada", SHARED, **save, version=1, content=later))["body"]
        await expect(page.get_by_test_id("layout-newer")).to_contain_text("ada saved a newer")
        await page.get_by_role("button", name="Save", exact=True).click()
        refused = page.get_by_test_id("layout-refused")
        await expect(refused).to_contain_text("ada saved the layout 'Day' since, as version 2")
        await refused.get_by_role("button", name="Save mine as").click()
        await page.get_by_label("Name", exact=True).fill("Night")
        await page.locator("form").get_by_role("button", name="Save").click()
        await expect(page.get_by_role("heading", name="Night")).to_be_visible()
        await expect(panel(page, "Commands")).to_be_visible()
        await tab.open("layout/@alpha/Day")
        await expect(page.get_by_text("ada was here")).to_be_visible()


async def test_of_two_robots_the_keyboard_drives_the_one_that_is_worked_at(
    browser: Browser, site: Machines
) -> None:
    await keep(site, "Two", TWO)
    async with person(browser, site, "otto", "layout/otto/Two") as tab:
        page = tab.page
        one, two = panel(page, "Teleop · one"), panel(page, "Teleop · two")
        for each in (one, two):
            await each.get_by_role("button", name="Take control").click()
            await expect(each.get_by_test_id("control")).to_contain_text("You have control")
        site.forget()
        await page.keyboard.down("Shift")
        await page.keyboard.down("ArrowUp")
        await until(lambda: any(speed > 0 for speed in speeds(site.two)))
        assert not any(speeds(site.one))
        await one.get_by_role("heading", name="Teleop · one").click()  # the keys are still held
        await expect(two.get_by_test_id("deadman")).to_have_text("○ released")
        await until(lambda: speeds(site.two)[-1] == 0)
        await expect(one.get_by_test_id("deadman")).to_have_text("○ released")
        assert not any(speeds(site.one))
        await page.keyboard.up("ArrowUp")
        await page.keyboard.up("Shift")
        await page.keyboard.down("Shift")
        await page.keyboard.down("ArrowUp")
        await until(lambda: any(speed > 0 for speed in speeds(site.one)))
        await page.evaluate("dispatchEvent(new Event('blur'))")
        await until(lambda: speeds(site.one)[-1] == 0)
        await page.keyboard.up("ArrowUp")
        await page.keyboard.up("Shift")


async def test_nothing_is_driven_from_a_panel_out_of_sight_or_in_a_layout_that_is_edited(
    browser: Browser, site: Machines
) -> None:
    await keep(
        site,
        "Long",
        {"columns": [{"panels": [{"kind": "teleop", "robot": "one"}, *[{"kind": "note"}] * 9]}]},
    )
    async with person(browser, site, "otto", "layout/otto/Long") as tab:
        page = tab.page
        one = panel(page, "Teleop · one")
        await one.get_by_role("button", name="Take control").click()
        await expect(one.get_by_test_id("control")).to_contain_text("You have control")
        site.forget()
        await page.keyboard.down("Shift")
        await page.keyboard.down("ArrowUp")
        await until(lambda: any(speed > 0 for speed in speeds(site.one)))
        await page.locator("main").evaluate("main => main.scrollTo(0, main.scrollHeight)")
        await until(lambda: speeds(site.one)[-1] == 0)
        await expect(one.get_by_test_id("deadman")).to_have_text("○ released")
        await page.keyboard.up("ArrowUp")
        await page.keyboard.up("Shift")
        await page.locator("main").evaluate("main => main.scrollTo(0, 0)")
        await page.get_by_role("button", name="Edit").click()
        site.forget()
        await one.get_by_role("heading", name="Teleop · one").click()
        await page.keyboard.down("Shift")
        await page.keyboard.down("ArrowUp")
        await expect(one.get_by_test_id("deadman")).to_have_text("○ released")
        await page.keyboard.up("ArrowUp")
        await page.keyboard.up("Shift")
        assert not any(speeds(site.one))
        # The bar with the emergency stop is in view wherever the layout is scrolled to.
        await expect(page.get_by_test_id("estop")).to_be_in_viewport()


async def test_control_ends_with_the_last_panel_that_needs_it(
    browser: Browser, site: Machines
) -> None:
    same = {
        "columns": [
            {"panels": [{"kind": "teleop", "robot": "one", "title": title}]} for title in "ab"
        ]
    }
    await keep(site, "Same", same)
    async with person(browser, site, "otto", "layout/otto/Same") as tab:
        page = tab.page
        await panel(page, "a").get_by_role("button", name="Take control").click()
        for name in "ab":
            await expect(panel(page, name).get_by_test_id("control")).to_contain_text("You have")
        await page.get_by_role("button", name="Edit").click()
        await page.get_by_role("button", name="Remove a").click()
        await expect(panel(page, "b").get_by_test_id("control")).to_contain_text("You have")
        await page.get_by_role("button", name="Remove b").click()
        await tab.open("people")
        await expect(page.get_by_text("/tenant/alpha/actuator/cmd_vel")).to_have_count(0)


@pytest.mark.parametrize(("wide", "high"), [(1440, 900), (390, 844)])
async def test_layouts_suit_every_screen_and_everybody(
    browser: Browser, site: Machines, axe: str, wide: int, high: int
) -> None:
    async with person(browser, site, "otto", "layout") as tab:
        page = tab.page
        await page.set_viewport_size({"width": wide, "height": high})
        await page.get_by_role("heading", name="For each robot").wait_for()
        await page.evaluate(axe)
        assert await violations(page, RULES) == []
        await tab.open("layout?robot=one")
        await expect(panel(page, "Teleop · one")).to_be_visible()
        await expect(page.get_by_test_id("map")).to_be_visible()
        assert await violations(page, RULES) == []
        assert not await scrolls_sideways(page)
        await page.get_by_role("button", name="Edit").click()
        await page.get_by_role("button", name=re.compile("^Settings of Map")).click()
        assert await violations(page, RULES) == []
        assert not await scrolls_sideways(page)
        if wide < 900:
            assert await page.evaluate(SMALL) == []
        await tab.shoot(f"layout-{wide}")


async def test_what_is_no_layout_of_ones_own_says_what_to_do(
    browser: Browser, site: Machines
) -> None:
    async with person(browser, site, "otto", "layout/ada/Hers") as tab:
        await expect(tab.page.get_by_text("Ask ada to share it")).to_be_visible()
        await tab.open("layout/otto/gone")
        await expect(tab.page.get_by_test_id("layout-refused")).to_contain_text("no layout 'gone'")
        await keep(
            site,
            "Odd",
            {
                "columns": [
                    {
                        "panels": [
                            {"kind": "camera", "path": "/x"},
                            {"kind": "teleop", "robot": "gone"},
                            {"kind": "plot", "plots": [["/tenant/alpha/sensor/none#x"]]},
                        ]
                    }
                ]
            },
        )
        tab.expected.append("404")  # the series of what is gone
        await tab.open("layout/otto/Odd")
        await expect(tab.page.get_by_text("▲ gone is not available")).to_be_visible()
        await expect(tab.page.get_by_text("▲ /x is not available")).to_be_visible()
        await expect(tab.page.get_by_test_id("broken")).to_have_count(0)


async def test_nobody_is_sent_off_by_a_panel_of_a_layout_that_is_edited(
    browser: Browser, site: Machines
) -> None:
    panels = [{"kind": "teleop", "robot": "one"}], [{"kind": "map", "robot": "one"}]
    await keep(site, "Going", {"columns": [{"panels": each} for each in panels]})
    async with person(browser, site, "otto", "layout/otto/Going") as tab:
        page = tab.page
        aim, dock = page.get_by_test_id("aim"), page.get_by_role("button", name="Dock")
        await aim.click()
        await expect(aim).to_have_attribute("aria-pressed", "true")
        await expect(dock).to_be_enabled()
        site.forget()
        await page.get_by_role("button", name="Edit").click()
        await expect(aim).to_be_disabled()
        await expect(aim).to_have_attribute("aria-pressed", "false")
        await expect(dock).to_be_disabled()
        await page.get_by_test_id("map").click()
        await page.get_by_role("button", name="Edit").click()
        await expect(aim).to_be_enabled()
        await expect(aim).to_have_attribute("aria-pressed", "false")
        assert site.one == []
