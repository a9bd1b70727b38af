"""Many robots at once: found, ordered by what is wrong with them, and stopped and reset together."""

from __future__ import annotations

import re
from collections.abc import AsyncGenerator

import pytest
from playwright.async_api import Browser, Page, expect

from browser.movers import Movers, movers, person

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
ROBOTS = 500


@pytest.fixture
async def gateway() -> AsyncGenerator[Movers]:
    """Run a gateway with robots of three tenants."""
    async with movers() as found:
        yield found


def row(page: Page, name: str) -> str:
    """Return the selector of a robot's line."""
    return f'tr[data-robot="{name}"]'


async def names(page: Page) -> list[str | None]:
    """List the robots in the order of the table."""
    lines = page.locator("tr[data-robot]")
    return [await one.get_attribute("data-robot") for one in await lines.all()]


async def test_robots_are_stopped_together_and_reset_after_a_look_at_the_list(
    browser: Browser, gateway: Movers
) -> None:
    async with person(browser, gateway, "ada") as tab:
        page = tab.page
        await tab.open("fleet")
        for one in ("near", "far"):
            await page.get_by_label(f"Select {one}").check()
        bulk = page.get_by_test_id("bulk")
        await bulk.get_by_role("button", name="Stop 2").click()
        await expect(page.locator(row(page, "near"))).to_contain_text("stopped")
        await expect(page.locator(row(page, "far"))).to_contain_text("stopped")
        await expect(page.locator(row(page, "pair"))).not_to_contain_text("stop", ignore_case=False)
        assert (await names(page))[-1] == "pair"  # what needs nobody comes last
        await bulk.get_by_role("button", name="Reset 2").click()
        dialog = page.get_by_role("dialog")
        await expect(dialog.get_by_role("listitem")).to_have_count(2)
        await dialog.get_by_role("button", name="Cancel").click()
        await expect(page.locator(row(page, "near"))).to_contain_text("stopped")
        await bulk.get_by_role("button", name="Reset 2").click()
        await dialog.get_by_role("button", name="Reset 2").click()
        await expect(page.get_by_text("Reset: 2 of 2 done")).to_be_visible()
        await expect(page.get_by_test_id("estop-active")).to_have_count(0)


async def test_one_robot_is_stopped_in_its_line_and_no_other(
    browser: Browser, gateway: Movers
) -> None:
    async with person(browser, gateway, "ada") as tab:
        page = tab.page
        await tab.open("fleet")
        await page.get_by_role("button", name="Stop near").press("Enter")
        await expect(page.locator(row(page, "near"))).to_contain_text("stopped")
        await page.get_by_role("button", name=re.compile("needs? attention")).click()
        await expect(page.locator("tr[data-robot]")).to_have_count(1)
        await page.get_by_role("button", name="Reset near", exact=True).last.press("Enter")
        await expect(page.locator("tr[data-robot]")).to_have_count(0)
        await page.get_by_role("button", name="Show all").click()
        await expect(page.locator("tr[data-robot]")).to_have_count(3)


async def test_who_may_reset_nothing_is_not_offered_it(browser: Browser, gateway: Movers) -> None:
    async with person(browser, gateway, "otto") as tab:
        page = tab.page
        await tab.open("fleet")
        await page.get_by_label("Select all shown").check()
        await page.get_by_test_id("bulk").get_by_role("button", name="Stop 3").click()
        await expect(page.locator(row(page, "near"))).to_contain_text("stopped")
        await expect(page.get_by_role("button", name=re.compile("Reset"))).to_have_count(0)


async def test_hundreds_of_robots_are_filtered_grouped_and_scrolled(browser: Browser) -> None:
    async with movers(ROBOTS) as gateway, person(browser, gateway, "ada", "fleet") as tab:
        page = tab.page
        count = page.get_by_test_id("fleet-count")
        await expect(count).to_have_text(f"{ROBOTS} robots")
        lines = page.locator("tr[data-robot]")
        await expect(lines.first).to_be_visible()
        assert await lines.count() < 60  # only what is in sight is drawn
        body = page.get_by_role("region", name="Robots")
        await body.evaluate("(one) => one.scrollTo(0, one.scrollHeight)")
        await expect(page.locator(row(page, f"robot-{ROBOTS - 1}"))).to_be_visible()
        # On a phone and a tablet, too, each name has room: rows in place of others make no columns.
        name = page.locator(row(page, f"robot-{ROBOTS - 1}")).get_by_role("link").first
        for width in (390, 1024, 1366):
            await page.set_viewport_size({"width": width, "height": 860})
            await body.evaluate("(one) => one.scrollTo(0, one.scrollHeight)")
            await expect(name).to_be_visible()
            assert await name.evaluate("(one) => one.parentElement.clientWidth") > 90
        await page.get_by_label("Group by").select_option("tenant")
        await expect(page.get_by_role("rowheader", name=re.compile("t0"))).to_be_attached()
        await page.get_by_label("Tenant", exact=True).select_option("t2")
        await expect(count).to_have_text(f"125 of {ROBOTS} robots")
        await page.get_by_label("Search robots").fill("robot-002")
        await expect(lines).to_have_count(1)
        await page.reload()  # the address has the filters
        await expect(lines).to_have_count(1)
        await page.get_by_role("button", name="Show all").click()
        await page.get_by_label("Group by").select_option("")
        await page.get_by_role("button", name="Robot", exact=True).click()
        await page.get_by_role("button", name=re.compile("^Robot")).first.click()
        await expect(page.locator(row(page, f"robot-{ROBOTS - 1}"))).to_be_visible()
        await tab.shoot("fleet")
