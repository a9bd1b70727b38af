"""Who may what, and who has what: approvals, plans and leases on the dashboard."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import httpx
import pytest
from playwright.async_api import Browser, Page, expect

from browser.watched import Watched, signed_in
from configuration import backend, key, listener, role, rule, table
from rcp_gateway.log import configure
from rcp_gateway.testing import serve
from rcp_kernel.config.file import parse

pytestmark = [pytest.mark.anyio, pytest.mark.paired]
expect.set_options(timeout=60_000)  # ms
PEOPLE = {"ada": "admin", "otto": "operator", "lena": "learner"}
GATEWAY = (
    listener()
    + table("plugins.dashboard")
    + backend("rover", use="sim")
    + role(
        "learner",
        rule("*", "/**", "/system/leases", "/system/commands", "/system/status"),
        approve=["/action/dock", "/param/speed_limit"],
        priority=10,
    )
    + "".join(key(n, f"key-of-{n}-which-is-long", role=held) for n, held in PEOPLE.items())
    + table(
        "[envelopes]",
        name="slowly",
        paths=["/param/speed_limit"],
        roles=["operator"],
        rate={"": 0.01},
    )
)


@pytest.fixture(scope="module")
async def url() -> AsyncGenerator[str]:
    """Run a gateway with a rover in this process; yield its address."""
    configure("error", "json")
    async with serve(parse(GATEWAY, "test")) as served:
        yield next(facts["url"] for facts in served.server.status.transports if "url" in facts)


@asynccontextmanager
async def person(browser: Browser, url: str, name: str, page: str = "") -> AsyncGenerator[Watched]:
    """Open a page as one of the people."""
    key = f"key-of-{name}-which-is-long"
    async with signed_in(browser, url, key, name) as tab:
        await tab.open(page)
        yield tab


async def ask(page: Page, value: str) -> None:
    """Ask for another speed limit, and to have it set once somebody approves."""
    form = page.get_by_test_id("ask-write")
    await form.get_by_label("value").fill(value)
    await form.get_by_role("button", name="Write", exact=True).click()
    await expect(form.get_by_test_id("refusal")).to_have_attribute("data-code", "approval_required")
    await form.get_by_role("button", name="Ask for approval").click()


async def test_what_a_person_has_to_approve_goes_on_when_granted(
    browser: Browser, url: str
) -> None:
    limit = "explore?path=/tenant/alpha/param/speed_limit"
    async with (
        person(browser, url, "ada") as ada,
        person(browser, url, "lena", limit) as lena,
    ):
        await ask(lena.page, "0.7")
        await expect(lena.page.get_by_test_id("badge")).to_have_count(0)  # not hers to decide
        await expect(ada.page.get_by_test_id("badge")).to_contain_text("1")
        await ada.page.get_by_role("link", name="Commands").click()
        asked = ada.page.get_by_role("article", name="lena requests")
        await expect(asked).to_contain_text("0.7")
        await expect(asked).to_contain_text("expires in")
        await ada.shoot("approval-asked")
        await asked.get_by_role("button", name="Approve").click()
        await expect(lena.page.get_by_test_id("answer")).to_contain_text("completed")
        await expect(lena.page.get_by_test_id("value")).to_contain_text("0.7")
        await expect(ada.page.get_by_test_id("badge")).to_have_count(0)


async def test_what_is_refused_is_told_with_the_reason(browser: Browser, url: str) -> None:
    limit = "explore?path=/tenant/alpha/param/speed_limit"
    async with (
        person(browser, url, "ada", "commands") as ada,
        person(browser, url, "lena", limit) as lena,
    ):
        await ask(lena.page, "2.4")
        asked = ada.page.get_by_role("article", name="lena requests")
        await asked.get_by_label("Reason").fill("too fast for the hall")
        await asked.get_by_role("button", name="Reject").click()
        status_text = lena.page.get_by_test_id("approval")
        await expect(status_text).to_contain_text("ada rejected it: too fast for the hall")
        await lena.shoot("approval-refused")


async def test_who_may_not_decide_is_not_offered_it(browser: Browser, url: str) -> None:
    dock = "explore?path=/tenant/alpha/action/dock"
    async with (
        person(browser, url, "lena", dock) as lena,
        person(browser, url, "otto", "commands") as otto,
    ):
        await lena.page.get_by_role("button", name="Execute", exact=True).click()
        await expect(lena.page.get_by_test_id("refusal")).to_be_visible()
        await lena.open("commands")
        own = lena.page.get_by_role("article", name="lena requests")
        await expect(own).to_contain_text("someone else must decide")
        await expect(own.get_by_role("button")).to_have_count(0)
        await expect(otto.page.get_by_test_id("approvals")).to_have_count(0)


async def test_a_plan_is_shown_step_by_step_and_cancelled(browser: Browser, url: str) -> None:
    plan: dict[str, Any] = {
        "name": "rounds",
        "steps": [
            {"do": "read", "path": "/tenant/alpha/sensor/pose", "id": "start"},
            {"do": "wait", "until": "sensor.battery.percentage > 2.0", "deadline": 300},
            {"do": "execute", "path": "/tenant/alpha/action/dock"},
        ],
    }
    headers = {"authorization": "Bearer key-of-otto-which-is-long"}
    async with (
        httpx.AsyncClient(base_url=url, headers=headers) as client,
        person(browser, url, "otto", "commands") as otto,
    ):
        answer = await client.post("/rcp/v1/context/system/plans", json=plan)
        assert answer.status_code == 202, answer.text
        shown = otto.page.get_by_test_id("plans")
        await expect(shown).to_contain_text("1 of 3")
        await expect(shown.locator('[data-step="start"]')).to_contain_text("completed")
        await expect(shown.locator('[data-step="2"]')).to_contain_text("running")
        await otto.shoot("plan-running")
        await shown.get_by_role("button", name="Cancel plan").click()
        await expect(shown.locator('[data-status="cancelled"]')).to_be_visible()


async def drive(tab: Watched) -> Page:
    """Ask for control of the rover."""
    await tab.open("teleop")
    await tab.page.get_by_role("button", name="Take control").click()
    return tab.page


async def test_who_has_control_is_seen_and_a_higher_priority_takes_it_over(
    browser: Browser, url: str
) -> None:
    async with person(browser, url, "lena") as lena, person(browser, url, "otto") as otto:
        await drive(lena)
        await expect(lena.page.get_by_test_id("control")).to_contain_text("You have control")
        await expect(otto.page.get_by_test_id("holder")).to_contain_text("lena")
        await otto.shoot("control-held")
        await drive(otto)
        refusal = otto.page.get_by_test_id("refusal")
        await expect(refusal).to_have_attribute("data-code", "lease_held")
        await otto.page.get_by_label("Reason for taking over").fill("the hall is full")
        await otto.shoot("control-refused")
        await otto.page.get_by_role("button", name="Take over").click()
        await expect(otto.page.get_by_test_id("control")).to_contain_text("You have control")
        lost = lena.page.get_by_test_id("refusal")
        await expect(lost).to_contain_text("the hall is full")
        await expect(lena.page.get_by_test_id("control")).to_contain_text("Someone else")
        await lena.page.get_by_role("button", name="Take control").click()
        await expect(lost).to_have_attribute("data-code", "lease_held")
        await lena.page.get_by_label("Reason for taking over").fill("mine again")
        await lena.page.get_by_role("button", name="Take over").click()
        await expect(lost).to_have_attribute("data-code", "lease_held")  # of a lower priority
        await lena.page.get_by_role("button", name="Take control when free").click()
        await otto.page.get_by_role("button", name="Release control").click()
        await expect(lena.page.get_by_test_id("control")).to_contain_text("You have control")


async def test_a_refusal_of_a_value_is_over_when_another_is_entered(
    browser: Browser, url: str
) -> None:
    headers = {"authorization": "Bearer key-of-otto-which-is-long"}
    async with (
        httpx.AsyncClient(base_url=url, headers=headers) as client,
        person(browser, url, "otto", "explore?path=/tenant/alpha/param/speed_limit") as tab,
    ):
        present = (await client.get("/rcp/v1/context/tenant/alpha/param/speed_limit")).json()[
            "body"
        ]
        form = tab.page.get_by_test_id("ask-write")
        refusal, value = form.get_by_test_id("refusal"), form.get_by_label("value")
        write = form.get_by_role("button", name="Write", exact=True)
        await value.fill(str(present))  # any other one would change it too fast
        await write.click()
        await expect(form.get_by_test_id("answer")).to_be_visible()
        await value.fill("1.9")
        await write.click()
        await expect(refusal).to_have_attribute("data-code", "out_of_range")
        await value.fill("1.8")
        await expect(form.get_by_role("alert")).to_have_count(0)
        await value.fill("1.9")  # what is entered again was refused all the same
        await expect(refusal).to_be_visible()
