"""Parameters while something else goes on: typing halts, robots are out of reach, others write, people approve."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import pytest
from playwright.async_api import Browser, Dialog, Page, expect

from browser.test_dashboard_parameters import GAINS, field, looking
from browser.watched import Watched
from browser.worlds import Teller, world
from configuration import role, rule
from ports import free_port
from rcp_kernel.model import Resource

pytestmark = pytest.mark.anyio
expect.set_options(timeout=10_000)  # ms
PLAIN = [Resource(name=f"param/{name}", description="It.", value=float) for name in "abc"]
NEEDS = role("most", rule("*", "/**"), approve=["/tenant/alpha/param/b"])


@asynccontextmanager
async def plain(browser: Browser, **more: Any) -> AsyncGenerator[tuple[Watched, Teller]]:
    """Show a robot of which each parameter is written by itself; all of them are 5."""
    async with world({"arm": ("alpha", PLAIN)}, **more) as there:
        robot = there.robots["arm"]
        robot.values.update({f"param/{name}": 5.0 for name in "abc"})
        async with looking(browser, there.url, 3) as tab:
            await expect(field(tab.page, "c")).to_have_value("5")
            yield tab, robot


async def write(page: Page, count: int) -> None:
    await page.get_by_role("button", name=f"Write {count}").click()


async def test_a_digit_that_is_typed_anew_comes_where_the_old_one_was(browser: Browser) -> None:
    async with plain(browser) as (tab, _):
        page, keys = tab.page, tab.page.keyboard
        await page.get_by_label("Show", exact=True).select_option("all")
        await field(page, "a").focus()
        await keys.press("End")
        await keys.type(".5")
        await keys.press("Backspace")  # 5. is what the robot has
        await expect(field(page, "a")).to_have_value("5.")
        await keys.type("7")
        await expect(field(page, "a")).to_have_value("5.7")
        await keys.press("Backspace")
        await keys.press("Enter")
        await expect(field(page, "a")).to_have_value("5")
        await expect(page.get_by_test_id("pending")).to_have_count(0)


async def test_a_robot_that_cannot_be_asked_after_a_write_is_asked_once_and_then_when_wanted(
    browser: Browser,
) -> None:
    async with plain(browser) as (tab, robot):
        page = tab.page
        asked = 0
        read = robot.read

        async def counted(name: str) -> Any:
            nonlocal asked
            asked += 1
            return await read(name)

        async def take(_: Any) -> None:
            robot.lost = "out of reach"
            robot.read = counted

        robot.takes["param/a"] = take
        await field(page, "a").fill("7")
        await write(page, 1)
        told = page.get_by_test_id("written")
        await expect(told).to_contain_text("1 could not be read back")
        again = page.get_by_role("button", name="Ask the robot again")
        await again.click()
        await expect(again).to_be_enabled()
        await expect(field(page, "b")).to_be_editable()
        assert asked == 2, "as often as somebody wanted it"
        robot.lost = ""
        await again.click()
        await expect(told).to_have_text("✓ Written and read back: 1.")


async def test_what_somebody_else_has_changed_is_written_over_only_after_a_question(
    browser: Browser,
) -> None:
    async with plain(browser) as (tab, robot):
        page = tab.page
        await field(page, "a").fill("7")
        await field(page, "b").fill("7")
        robot.values["param/a"] = 9.0
        await write(page, 2)
        dialog = page.get_by_role("dialog")
        await expect(dialog).to_contain_text("a (robot has 9)")
        await dialog.get_by_role("button", name="Cancel").click()
        row = page.locator('tr[data-parameter="a"]')
        await expect(row).to_contain_text("Changed meanwhile: robot has 9, had 5.")
        assert robot.writes == []
        await write(page, 2)
        await dialog.get_by_role("button", name="Write all the same").click()
        await expect(page.get_by_test_id("written")).to_have_text("✓ Written and read back: 2.")
        await page.get_by_role("button", name="Take back what was written").click()
        await expect(field(page, "a")).to_have_value("9")


async def test_what_waits_for_approval_can_be_left_and_nothing_discarded_is_sent(
    browser: Browser,
) -> None:
    async with plain(browser, role="most", more=NEEDS) as (tab, robot):
        page = tab.page
        for name in "abc":
            await field(page, name).fill("7")
        await write(page, 3)
        await page.get_by_role("button", name="Ask for approval").click()
        await expect(field(page, "c")).not_to_be_editable()
        await page.get_by_label("Writing").get_by_role("button", name="Close").click()
        await expect(field(page, "c")).to_be_editable()
        await write(page, 2)
        await expect(page.get_by_role("button", name="Ask for approval")).to_be_visible()
        await page.get_by_role("button", name="Discard all").click()
        await expect(page.get_by_role("button", name="Ask for approval")).to_have_count(0)
        assert robot.writes == [("param/a", 7.0)]


async def test_pending_changes_outlive_the_gateway_and_are_not_reloaded_away_unasked(
    browser: Browser,
) -> None:
    port = free_port()
    async with AsyncExitStack() as whole:
        before = await whole.enter_async_context(AsyncExitStack())
        there = await before.enter_async_context(world({"arm": ("alpha", GAINS)}, port))
        there.robots["arm"].values.update({"param/d": 1.0, "param/i": 1.0, "param/p": 1.0})
        tab = await whole.enter_async_context(looking(browser, there.url, 3))
        tab.expected += ["WebSocket", "ERR_"]
        page = tab.page
        await field(page, "p").fill("2.5")
        await field(page, "i").fill("3.5")
        await before.aclose()
        await expect(page.locator('[data-state="waiting"]')).to_be_attached()
        there = await whole.enter_async_context(world({"arm": ("alpha", GAINS[1:])}, port))
        robot = there.robots["arm"]
        robot.values.update({"param/i": 1.0, "param/p": 1.0})
        await expect(page.get_by_test_id("parameter-count")).to_have_text("Parameters: 2")
        await expect(field(page, "p")).to_have_value("2.5")
        robot.remove("param/i")
        await expect(page.get_by_test_id("pending")).to_contain_text("does not have these now")
        async with page.expect_event("dialog") as asking:
            page.on("dialog", _stay)
            await page.evaluate("() => void setTimeout(() => location.reload())")
        assert (await asking.value).type == "beforeunload"
        await write(page, 1)
        await expect(page.get_by_test_id("written")).to_have_text("✓ Written and read back: 1.")
        assert robot.writes == [("param/p", 2.5)]
        await page.get_by_role("button", name="Discard all").click()


async def _stay(dialog: Dialog) -> None:
    await dialog.dismiss()
