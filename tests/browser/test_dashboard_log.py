"""What went wrong, and what was done: warnings on the overview, the log and its filters, with the real demo."""

from __future__ import annotations

import re
from collections.abc import AsyncGenerator

import httpx
import pytest
from playwright.async_api import Browser, expect

from browser.watched import Watched, log_in, signed_in, watched
from browser.worlds import KEY, live, world
from docs.demo import Demo

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
FAULT = {"fault": "sensor_stop", "target": "sensor/battery"}


@pytest.fixture
async def robot(running: Demo) -> AsyncGenerator[httpx.AsyncClient]:
    """Make things go wrong past the page, as the operator; they are well again afterwards."""
    headers = {"authorization": f"Bearer {running.key}"}
    base = f"{running.url}/rcp/v1/context/tenant/alpha/service"
    async with httpx.AsyncClient(base_url=base, headers=headers, timeout=60) as client:
        yield client
        (await client.post("/clear_faults", params={"wait": 10})).raise_for_status()


@pytest.fixture
async def tab(browser: Browser, running: Demo) -> AsyncGenerator[Watched]:
    """Open the demo's dashboard as the admin."""
    async with signed_in(browser, running.url, running.admin, "demo-admin") as found:
        yield found


async def test_what_goes_wrong_is_on_the_overview_with_the_way_there(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = tab.page
    card = page.locator('[data-robot="rover-alpha"]')
    warnings = page.get_by_role("region", name="Warnings", exact=True)
    await expect(card).to_contain_text("none")
    (await robot.post("/inject_fault", json=FAULT)).raise_for_status()
    await expect(card).to_contain_text("▲")
    await expect(warnings).to_contain_text("has sent no new sample within its deadline")
    await expect(warnings.get_by_role("link", name="alpha/sensor/battery").first).to_be_visible()
    await expect(warnings.get_by_role("link", name="alpha/event/fault").first).to_be_visible()
    await tab.shoot("overview-fault")
    (await robot.post("/clear_faults", params={"wait": 10})).raise_for_status()
    await expect(card).to_contain_text("none")
    await warnings.get_by_role("link", name="alpha/event/fault").first.click()
    await expect(page.get_by_role("heading", name="/tenant/alpha/event/fault")).to_be_visible()


async def test_the_log_is_filtered_by_severity_path_and_words(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = tab.page
    (await robot.post("/inject_fault", json=FAULT)).raise_for_status()
    await tab.open("log")
    rows = page.locator("tbody tr[data-source]")
    fault = rows.filter(has_text="alpha/event/fault").first
    await expect(fault).to_have_attribute("data-level", "warning")
    await expect(page.locator("tr[data-level=info]").first).to_be_visible()
    await page.get_by_label("Minimum severity").select_option("warning")
    await expect(page.locator("tr[data-level=info]")).to_have_count(0)
    await expect(fault).to_be_visible()
    await page.reload()  # the address keeps it
    await expect(page.get_by_label("Minimum severity")).to_have_value("warning")
    await page.get_by_role("button", name="Show all").click()
    await page.get_by_label("Path").fill("alpha/event")
    await expect(rows.filter(has_text="delta")).to_have_count(0)
    await expect(fault).to_be_visible()
    await page.get_by_label("Filter").fill("no such words")
    await expect(page.get_by_text("match these filters")).to_be_visible()


async def test_a_path_that_tells_very_often_has_one_row(browser: Browser) -> None:
    robots = {"rover": ("alpha", [live("event/bump")])}
    async with world(robots) as gateway, watched(browser, gateway.url) as tab:
        await tab.open()
        await log_in(tab.page, KEY)
        await expect(tab.page.locator('[data-robot="rover"]')).to_contain_text("ready")
        await tab.open("log")
        bumps = tab.page.locator("tr[data-source=event]").filter(has_text="alpha/event/bump")
        gateway.publish("rover", "event/bump", {"message": "the first"})
        await expect(bumps).to_contain_text("the first")
        for number in range(30):
            gateway.publish("rover", "event/bump", {"message": f"bump {number}"})
        often = bumps.get_by_role("button", name="show all")
        await expect(often).to_be_visible()
        await expect(bumps).to_have_count(1)
        await often.click()
        for number in range(5):  # one by one from now on
            gateway.publish("rover", "event/bump", {"message": f"later {number}"})
        await expect(bumps.nth(3)).to_be_visible()


async def test_a_pause_holds_what_comes_and_the_audit_is_filtered(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = tab.page
    await tab.open("log?q=inject_fault")
    await expect(page.get_by_role("button", name="Audit")).to_have_attribute("aria-pressed", "true")
    audits = page.locator("tr[data-source=audit]")
    await page.get_by_role("button", name="Pause").click()
    before = await audits.count()  # records of earlier tests come until here
    (await robot.post("/inject_fault", json=FAULT)).raise_for_status()
    await expect(page.get_by_role("button", name=re.compile(r"Resume \(\d+\)"))).to_be_visible()
    assert await audits.count() == before
    await page.get_by_role("button", name="Resume").click()
    await expect(audits.first).to_contain_text("demo-operator")
    await page.get_by_role("button", name="Show all").click()
    await page.get_by_label("Principal").select_option("demo-admin")
    await expect(audits.filter(has_text="by demo-admin").first).to_be_visible()
    await expect(audits.filter(has_text="by demo-operator")).to_have_count(0)
    await page.get_by_label("Type of audit record").select_option("login")
    await expect(audits.filter(has_not_text="login")).to_have_count(0)
    await tab.shoot("log-audit")
