"""The dashboard for everybody: what axe finds, the keyboard, and motion that is not wanted."""

from __future__ import annotations

from typing import Any

import httpx
import pytest
from playwright.async_api import Browser, Page, expect

from browser.accessible import SMALL, scrolls_sideways, violations
from browser.watched import Watched, log_in, watched
from docs.demo import Demo

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
PAGES = (
    "",
    "fleet",
    "teleop?robot=head-delta",
    "explore?path=/tenant/alpha/action/move_to",
    "explore?path=/tenant/alpha/sensor/pose",
    "parameters?robot=drone-gamma",
    "teleop?robot=rover-alpha",
    "teleop?robot=drone-gamma",
    "camera",
    "scene",
    "map",
    "plot?p=/tenant/alpha/sensor/pose%23position.x",
    "commands",
    "log",
    "people",
)
_FOCUS = """
() => {
  const at = document.activeElement;
  if (!at || at === document.body) return null;
  const style = getComputedStyle(at);
  const seen = style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 1;
  return { what: at.outerHTML.slice(0, 160), seen };
}
"""


async def settled(page: Page) -> None:
    await expect(page.locator("main")).not_to_contain_text("Loading")
    await expect(page.locator("main")).not_to_contain_text("Asking")


@pytest.mark.parametrize(
    ("theme", "rules"),
    [
        ("dark", ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]),
        ("light", ["color-contrast", "link-in-text-block"]),  # nothing else differs
    ],
)
async def test_axe_finds_nothing_serious_on_any_page(
    browser: Browser, running: Demo, axe: str, theme: Any, rules: list[str]
) -> None:
    headers = {"authorization": f"Bearer {running.key}"}
    async with (
        httpx.AsyncClient(base_url=running.url, headers=headers) as robot,
        watched(browser, running.url, color_scheme=theme) as tab,
    ):
        path = "/rcp/v1/context/tenant/alpha/service/inject_fault"
        fault = {"fault": "sensor_stop", "target": "sensor/battery", "seconds": 60}
        assert (await robot.post(path, json=fault)).is_success  # pages show that something is wrong
        await tab.open()
        await tab.connected()
        await tab.page.evaluate(axe)
        wrong: list[str] = []
        await tab.page.get_by_role("button", name="Log in").first.click()
        wrong += [f"login: {one}" for one in await violations(tab.page, rules)]
        await tab.page.get_by_role("button", name="Close").click()
        await log_in(tab.page, running.admin)
        await expect(tab.page.get_by_test_id("principal")).to_have_text("demo-admin")
        for name in PAGES:
            await tab.open(name)
            await settled(tab.page)
            wrong += [f"{name or 'overview'}: {one}" for one in await violations(tab.page, rules)]
        await tab.page.get_by_test_id("estop").click()
        await expect(tab.page.get_by_test_id("estop-active")).to_be_visible()
        wrong += [f"stopped: {one}" for one in await violations(tab.page, rules)]
        await tab.page.get_by_test_id("estop-reset").click()
        await expect(tab.page.get_by_test_id("estop-active")).to_have_count(0)
        assert not wrong, "\n".join(wrong)


async def test_every_page_is_reached_and_walked_through_by_keyboard(tab: Watched) -> None:
    page = tab.page
    await page.keyboard.press("Tab")
    await expect(page.get_by_role("link", name="Skip to content")).to_be_focused()
    for name in ("Explore", "Teleop", "Plot", "Commands", "Log", "Overview"):
        await page.get_by_role("link", name=name, exact=True).first.focus()
        await page.keyboard.press("Enter")
        await expect(page.get_by_role("main", name=name)).to_be_visible()
        await settled(page)
        await page.get_by_role("main").focus()
        for _ in range(12):
            await page.keyboard.press("Tab")
            found = await page.evaluate(_FOCUS)
            assert found is None or found["seen"], f"{name}: no visible focus on {found['what']}"


async def test_a_value_is_written_with_the_keyboard_alone(tab: Watched) -> None:
    page = tab.page
    await tab.open("explore")
    search = page.get_by_role("searchbox", name="Search")
    await search.focus()
    await page.keyboard.type("beta speed_limit")
    row = page.locator('[data-path="/tenant/beta/param/speed_limit"]')
    await expect(row).to_be_visible()
    await row.focus()
    await page.keyboard.press("Enter")
    field = page.get_by_test_id("ask-write").get_by_label("value")
    await field.focus()
    await page.keyboard.press("Control+A")
    await page.keyboard.type("0.6")
    await page.keyboard.press("Enter")
    await expect(page.get_by_test_id("answer")).to_contain_text("completed")


async def test_what_matters_is_told_to_those_who_do_not_look(tab: Watched, running: Demo) -> None:
    page = tab.page
    await expect(page.locator('[role="status"][data-state="open"]')).to_have_text("● Connected")
    await tab.open("explore?path=/tenant/beta/service/place_obstacle")
    form = page.get_by_test_id("ask-execute")
    await form.get_by_role("button", name="JSON").click()
    await form.get_by_label("Value as JSON").fill('{"x": 900, "y": 900, "size_x": 1, "size_y": 1}')
    await form.get_by_role("button", name="Execute", exact=True).click()
    await expect(form.get_by_role("alert")).to_contain_text("outside the warehouse")
    await page.keyboard.press("F9")
    await expect(page.get_by_role("alert").filter(has_text="Emergency stop")).to_be_visible()
    admin = {"authorization": f"Bearer {running.admin}"}
    body = {"type": "execute", "path": "/system/estop", "body": {"reset": True}}
    async with httpx.AsyncClient(base_url=running.url, headers=admin) as client:
        await client.post("/rcp/v1/messages", json=body)


async def test_nothing_moves_for_those_who_do_not_want_it(browser: Browser, running: Demo) -> None:
    async with watched(browser, running.url, reduced_motion="reduce") as tab:
        await tab.open("explore")
        await tab.connected()
        moving = await tab.page.evaluate(
            "[...document.querySelectorAll('*')].filter((one) => "
            "parseFloat(getComputedStyle(one).transitionDuration) > 0).length"
        )
        assert moving == 0


@pytest.mark.parametrize(("width", "height"), [(820, 1180), (390, 844)])
async def test_on_tablet_and_phone_all_fits_and_is_large_enough_for_fingers(
    browser: Browser, running: Demo, width: int, height: int
) -> None:
    async with watched(browser, running.url, has_touch=True, color_scheme="light") as tab:
        await tab.page.set_viewport_size({"width": width, "height": height})
        await tab.open()
        await tab.connected()
        await log_in(tab.page, running.admin)
        await expect(tab.page.get_by_test_id("principal")).to_have_text("demo-admin")
        for name in PAGES:
            await tab.open(name)
            await settled(tab.page)
            await expect(tab.page.get_by_test_id("estop")).to_be_in_viewport(ratio=1)
            assert not await scrolls_sideways(tab.page), f"{name} has to be scrolled sideways"
            assert not (small := await tab.page.evaluate(SMALL)), f"{name}: {small}"
