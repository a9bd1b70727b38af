"""The overview with the gateway's inventory: what each robot is, who has control, and a search by what it is."""

from __future__ import annotations

import httpx
import pytest
from playwright.async_api import Browser, Locator, Page, expect

from browser.watched import log_in, watched
from browser.worlds import KEY, OTHER, World, live, world
from rcp_kernel.model import Resource
from rcp_kernel.spi import RobotFacts

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
_DRONE = RobotFacts(kind="copter", vendor="Acme", firmware="PX4 1.16.0 (1c8ab2a0)", serial="4711")


def _fleet() -> dict[str, tuple[str, list[Resource]]]:
    move = Resource(name="actuator/move", description="Moves.", value=float, safe=0.0, valid_for=60)
    return {
        "falcon": ("alpha", [live("sensor/mode"), move]),
        "welder": ("beta", [live("sensor/mode")]),
        "one": ("gamma", [live("sensor/mode")]),
        "two": ("gamma", [live("sensor/other")]),
    }


def card(page: Page, name: str) -> Locator:
    return page.locator(f'[data-robot="{name}"]')


def describe(gateway: World) -> None:
    for name, facts in {"falcon": _DRONE, "welder": RobotFacts(kind="arm")}.items():
        gateway.robots[name].host.describe(facts)
    gateway.publish("falcon", "sensor/mode", "LOITER")


async def move(gateway: World) -> None:
    """Have somebody else command the drone, without a lease."""
    headers = {"authorization": f"Bearer {OTHER}"}
    asked = {"type": "write", "path": "/tenant/alpha/actuator/move", "body": 0.5, "valid_for": 60}
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as client:
        (await client.post("/rcp/v1/messages", json=asked, timeout=60)).raise_for_status()


async def test_a_card_tells_what_the_inventory_knows_and_words_find_it(browser: Browser) -> None:
    async with world(_fleet()) as gateway, watched(browser, gateway.url) as tab:
        page = tab.page
        await tab.open()
        await log_in(page, KEY)
        await tab.connected()
        describe(gateway)
        falcon = card(page, "falcon")
        for text in ("copter", "PX4 1.16.0 (1c8ab2a0)", "LOITER", "ready"):
            await expect(falcon).to_contain_text(text)
        await expect(falcon.get_by_test_id("holder")).to_have_text("○ free")
        await move(gateway)
        await expect(falcon.get_by_test_id("holder")).to_have_text(
            "◆ tablet commands actuator/move"
        )
        await expect(card(page, "two")).to_be_visible()
        await tab.shoot("inventory")
        search = page.get_by_role("searchbox", name="Search robots")
        await search.fill("drones")
        await expect(page.locator("[data-robot]")).to_have_count(1)
        await expect(falcon).to_be_visible()
        await search.fill("arm")
        await expect(card(page, "welder")).to_be_visible()
        await expect(page.locator("[data-robot]")).to_have_count(1)
        await search.fill("submarine")
        await expect(page.get_by_text("No robot matches")).to_be_visible()
        await search.fill("")
        await expect(page.locator("[data-robot]")).to_have_count(4)


async def test_without_the_inventory_the_cards_are_as_before(browser: Browser) -> None:
    fleet = _fleet()
    async with (
        world(fleet, more="[features]\ninventory = false") as gateway,
        watched(browser, gateway.url) as tab,
    ):
        page = tab.page
        await tab.open()
        await log_in(page, KEY)
        await tab.connected()
        describe(gateway)
        await expect(card(page, "falcon")).to_contain_text("LOITER")
        await expect(card(page, "falcon")).not_to_contain_text("copter")
        await page.get_by_role("searchbox", name="Search robots").fill("weld")
        await expect(page.locator("[data-robot]")).to_have_count(1)
        await expect(card(page, "welder")).to_be_visible()
