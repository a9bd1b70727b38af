"""Alarms on the dashboard: who sees them, and who acknowledges them with which words."""

from __future__ import annotations

import pytest
from playwright.async_api import Browser, expect

from browser.watched import signed_in
from configuration import backend, key, listener, table
from plugins.triggers.gateway import KIND, robot
from rcp_gateway.log import configure
from rcp_gateway.testing import ScriptedRobot, scripted, serve
from rcp_kernel.config.file import parse

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
OPERATOR, VIEWER = "operator-who-sees-alarms", "viewer-who-sees-no-alarms"
RULES = {
    "low": {
        "robot": "/tenant/alpha",
        "when": "sensor.battery < 20",
        "alarm": True,
        "severity": "critical",
        "message": "Battery low",
    },
    "hot": {"robot": "/tenant/alpha", "when": "sensor.heat > 80", "alarm": True, "message": "Hot"},
}


async def test_an_alarm_is_seen_and_acknowledged_with_a_comment(browser: Browser) -> None:
    configure("error", "json")
    tables = (
        listener(),
        table("plugins.dashboard"),
        backend("rover"),
        key("operator", OPERATOR),
        key("viewer", VIEWER),
        table("features.triggers", rules=RULES),
    )
    async with serve(parse("".join(tables), "test"), scripted(robot), features=(KIND,)) as served:
        url = next(f["url"] for f in served.server.status.transports if "url" in f)
        rover = served.life.backend
        assert isinstance(rover, ScriptedRobot)
        async with signed_in(browser, url, OPERATOR, "operator") as tab:
            page = tab.page
            await tab.open("alarms")
            await tab.connected()
            await expect(page.get_by_text("No alarms wait to be acknowledged.")).to_be_visible()
            rover.measure("sensor/battery", 10.0)
            rover.measure("sensor/heat", 90.0)
            badge = page.get_by_test_id("alarms")
            await expect(badge).to_contain_text("2")
            low = page.locator("article", has_text="Battery low")
            await expect(low).to_contain_text("still active")
            await tab.shoot("alarms")
            await low.get_by_label("Comment").fill("on my way")
            ready = low.locator("button[aria-disabled=false]")
            await ready.click()
            await expect(low).to_contain_text("by operator: on my way")
            await expect(badge).to_contain_text("1")
            rover.measure("sensor/battery", 90.0)
            await page.get_by_text("Closed").click()
            await expect(page.locator("details article")).to_contain_text("cleared")
            rover.measure("sensor/heat", 20.0)
            await expect(page.locator("article", has_text="Hot")).to_contain_text("cleared")
            await expect(badge).to_contain_text("1")  # somebody still has to say so
        async with signed_in(browser, url, VIEWER, "viewer") as tab:
            await tab.open("alarms")
            await tab.connected()
            await expect(tab.page.get_by_text("may not see alarms")).to_be_visible()
            links = tab.page.get_by_role("navigation", name="Pages").get_by_role("link")
            await expect(links.filter(has_text="Alarms")).to_have_count(0)
