"""What somebody sends, and what somebody approves: just that, once, and nothing that he has not seen."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from typing import Any

import httpx
import pytest
from playwright.async_api import Browser, Locator, Page, expect

from browser.input_helpers import held
from browser.machines import Machines, key_of, machines, person

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
_BOUND = 60.0  # s
_LONG = 2**53 + 1
_MOVE = "/tenant/alpha/action/move_to"
_SERIAL = "/tenant/alpha/param/serial"
_TWICE = """
(form) => new Promise((done) => {
  const seen = new MutationObserver(() => {
    if (!form.querySelector("[data-testid=answer]")) return;
    seen.disconnect();
    form.querySelector("button.primary").click();
    done();
  });
  seen.observe(form, { childList: true, subtree: true });
  form.querySelector("button.primary").click();
})
"""
"""Press the button, and once more at the moment when the answer is there."""
_SLIDES = """
(first) => new Promise((done) => {
  const button = first.querySelector("button[data-steady], [data-steady] button");
  const { x, y } = button.getBoundingClientRect();
  const seen = new MutationObserver(() => {
    if (first.isConnected) return;
    seen.disconnect();
    const under = document.elementFromPoint(x + 5, y + 5).closest("button");
    under.dispatchEvent(new MouseEvent("click", { bubbles: true, detail: 1 }));
    const { approval, command } = under.closest("[data-approval], [data-command]").dataset;
    done(approval ?? command);
  });
  seen.observe(document.body, { childList: true, subtree: true });
  button.click();
})
"""
"""Press the first, and where its button was as soon as it has gone; tell whose that is now."""
_AT_ONCE = """
() => {
  window.pressed = 0;
  const seen = new MutationObserver(() => {
    const button = document.querySelector("[data-testid=estop-reset]");
    if (!button) return;
    seen.disconnect();
    window.pressed = button.dispatchEvent(new MouseEvent("click", { bubbles: true, detail: 1 }));
  });
  seen.observe(document.body, { childList: true, subtree: true });
}
"""
"""Press what resets a stop at the moment when it comes."""


@pytest.fixture(scope="module")
async def running() -> AsyncGenerator[Machines]:
    async with machines() as made:
        yield made


@pytest.fixture
def told(running: Machines) -> Machines:
    """Return what machines are told in this test."""
    running.forget()
    return running


class Asking:
    """A person who asks and decides without a page."""

    def __init__(self, running: Machines, name: str) -> None:
        self._url = f"{running.url}/rcp/v1"
        self._headers = {"authorization": f"Bearer {key_of(name)}"}

    async def _send(self, **request: Any) -> Any:
        async with httpx.AsyncClient(headers=self._headers, timeout=_BOUND) as client:
            return (await client.post(f"{self._url}/messages", json=request)).json()

    async def ask(self, type_: str, path: str, value: Any) -> str:
        """Send what wants approval; return what it is asked by."""
        error = (await self._send(type=type_, path=path, body=value))["error"]
        assert error["code"] == "approval_required"
        return error["details"]["approval"]

    async def begin(self, path: str, value: Any) -> str:
        """Begin something that does not end by itself; return which command it is."""
        return (await self._send(type="execute", path=path, body=value))["command"]

    async def states(self) -> dict[str, str]:
        body = (await self._send(type="read", path="/system/approvals"))["body"]
        return {one["approval"]: one["status"] for one in body}

    async def approve(self) -> None:
        """Approve whatever waits."""
        for approval, status in (await self.states()).items():
            if status == "pending":
                await self.decide(approval, "approve")

    async def decide(self, approval: str, decision: str) -> None:
        body = {"id": approval, "decision": decision}
        answer = await self._send(type="execute", path="/system/approvals", body=body)
        assert answer["status"] == "completed", answer


def field(form: Locator, pointer: str) -> Locator:
    return form.locator(f"[data-pointer='{pointer}'] input")


async def pressed(page: Page, form: Locator) -> None:
    await form.locator("button.primary").first.click()
    await expect(page.get_by_test_id("refusal")).to_have_attribute("data-code", "approval_required")


async def test_whoever_approves_sees_the_whole_value_to_its_last_digit_and_letter(
    browser: Browser, told: Machines
) -> None:
    lena, ada = Asking(told, "lena"), Asking(told, "ada")
    goal = {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "yaw": None, "words": "on " * 200}
    hidden = {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "words": "slow \u202e\u200btsaf"}
    long = await lena.ask("execute", _MOVE, goal)
    turned = await lena.ask("execute", _MOVE, hidden)
    serial = await lena.ask("write", _SERIAL, str(_LONG))
    plan = {"steps": [{"do": "execute", "path": _MOVE, "value": goal} for _ in range(80)]}
    huge = await lena.ask("execute", "/system/plans", plan)
    async with person(browser, told, "ada", "commands") as tab:
        page = tab.page
        shown = page.locator(f"[data-approval={long}]")
        assert json.loads(await shown.locator("pre").inner_text()) == goal
        await expect(page.locator(f"[data-approval={serial}] pre")).to_contain_text(str(_LONG))
        words = page.locator(f"[data-approval={turned}] pre")
        await expect(words).to_contain_text(r"slow \u{202e}\u{200b}tsaf")
        unseen = page.locator(f"[data-approval={huge}]")
        await expect(unseen).to_contain_text("too long to display")
        await expect(unseen.get_by_role("button", name="Approve")).to_be_disabled()
        await tab.shoot("approval-whole")
    for one in (long, turned, serial, huge):
        await ada.decide(one, "reject")


async def test_a_long_number_is_sent_as_it_was_typed(browser: Browser, told: Machines) -> None:
    async with person(browser, told, "otto", f"explore?path={_SERIAL}") as tab:
        form = tab.page.get_by_test_id("ask-write")
        await form.get_by_label("value").fill(str(_LONG))
        await form.get_by_role("button", name="Write", exact=True).click()
        await expect(form.get_by_test_id("answer")).to_be_visible()
        await form.get_by_role("button", name="JSON").click()
        await form.get_by_label("Value as JSON").fill(str(-_LONG))
        await form.get_by_role("button", name="Write", exact=True).click()
        await expect(form.locator("pre")).to_contain_text(str(-_LONG))
        assert told.one == [("param/serial", _LONG), ("param/serial", -_LONG)]


async def test_what_is_sent_when_approved_is_what_the_form_shows(
    browser: Browser, told: Machines
) -> None:
    ada = Asking(told, "ada")
    async with person(browser, told, "lena", f"explore?path={_SERIAL}") as tab:
        form = tab.page.get_by_test_id("ask-write")
        value, offer = (
            form.get_by_label("value"),
            form.get_by_role("button", name="Ask for approval"),
        )
        await value.fill("5")
        await pressed(tab.page, form)
        await offer.click()
        await expect(value).to_be_disabled()
        await expect(form.get_by_test_id("kept")).to_have_text("5")
        await form.get_by_role("button", name="Stop waiting").click()
        await value.fill("6")
        await expect(form.get_by_test_id("approval")).to_have_count(0)  # it was asked for 5
        await pressed(tab.page, form)
        await offer.click()
        await ada.approve()
        await expect(form.get_by_test_id("answer")).to_be_visible()
        await expect(value).to_have_value("6")
        assert told.one == [("param/serial", 6)]


async def test_what_a_button_asks_for_is_sent_when_it_is_approved(
    browser: Browser, told: Machines
) -> None:
    ada = Asking(told, "ada")
    async with person(browser, told, "lena", "teleop?robot=one") as tab:
        buttons = tab.page.get_by_test_id("actions")
        async with held(buttons.get_by_role("button", name="Dock")):
            await expect(buttons.get_by_test_id("kept")).to_be_visible()
        await expect(buttons.get_by_test_id("kept")).to_have_text("null")
        await buttons.get_by_role("button", name="Ask for approval").click()
        await expect(buttons).to_contain_text("Waiting for approval")
        await ada.approve()
        await expect(buttons.get_by_test_id("action-status")).to_contain_text("completed")
        assert told.one == [("action/dock", None)]


async def test_what_nobody_approved_in_time_is_not_sent_and_may_be_asked_anew(
    browser: Browser,
) -> None:
    async with (
        machines(ttl=3) as told,
        person(browser, told, "lena", f"explore?path={_SERIAL}") as tab,
    ):
        form = tab.page.get_by_test_id("ask-write")
        await form.get_by_label("value").fill("5")
        await pressed(tab.page, form)
        waiting = form.get_by_role("button", name="Ask for approval")
        over = form.get_by_text("The approval has expired")
        await waiting.or_(over).first.click()
        await expect(over).to_be_visible()
        await expect(form.get_by_label("value")).to_be_enabled()
        await pressed(tab.page, form)
        ada = Asking(told, "ada")
        async with asyncio.timeout(_BOUND):
            while len(await ada.states()) < 2:  # noqa: ASYNC110 - it is asked as a person would
                await asyncio.sleep(0.1)
        assert told.one == []


async def test_a_second_press_and_a_held_key_send_nothing_a_second_time(
    browser: Browser, told: Machines
) -> None:
    async with person(browser, told, "otto", f"explore?path={_MOVE}") as tab:
        form = tab.page.get_by_test_id("ask-execute")
        for axis in "xyz":
            await field(form, f"/position/{axis}").fill("1")
        words = field(form, "/words")
        await words.fill("twice")
        await form.evaluate(_TWICE)
        await expect(form.locator("button.primary")).to_be_enabled()
        await words.fill("held")
        await words.focus()
        await tab.page.keyboard.down("Enter")
        await expect(form.get_by_test_id("answer")).to_be_visible()
        await expect(form.locator("button.primary")).to_be_enabled()
        await tab.page.keyboard.down("Enter")  # as it repeats
        await tab.page.keyboard.up("Enter")
        await words.fill("once more")
        await words.press("Enter")
        async with asyncio.timeout(_BOUND):
            while len(told.one) < 3:  # noqa: ASYNC110 - the machine is in this process
                await asyncio.sleep(0.02)
        assert [goal["words"] for _, goal in told.one] == ["twice", "held", "once more"]


async def test_nothing_is_approved_that_has_only_just_slid_under_the_pointer(
    browser: Browser, told: Machines
) -> None:
    lena, ada = Asking(told, "lena"), Asking(told, "ada")
    first, second = [await lena.ask("write", _SERIAL, value) for value in (71, 72)]
    async with person(browser, told, "ada", "commands") as tab:
        asked = tab.page.get_by_role("article")
        await expect(asked).to_have_count(2)
        await expect(asked.first).to_contain_text("71")  # what comes later stands below
        third = await lena.ask("write", _SERIAL, 73)
        await expect(asked).to_have_count(3)
        await expect(asked.first).to_contain_text("71")
        assert await asked.first.evaluate(_SLIDES) == second
        await asked.nth(1).get_by_role("button", name="Reject").click()
        await expect(asked).to_have_count(1)
        states = await ada.states()
        assert [states[one] for one in (first, second, third)] == [
            "approved",
            "pending",
            "rejected",
        ]
        await asked.first.get_by_role("button", name="Approve").click()
        await expect(asked).to_have_count(0)


async def test_neither_the_wrong_command_is_cancelled_nor_a_stop_reset_by_a_press_that_was_meant_for_what_stood_there(
    browser: Browser, told: Machines
) -> None:
    otto = Asking(told, "otto")
    goal = {"position": {"x": 1, "y": 0}, "words": "for ever"}
    made = [await otto.begin(_MOVE.replace("alpha", at), goal) for at in ("alpha", "beta")]
    async with person(browser, told, "ada", "commands") as tab:
        page = tab.page
        running = page.get_by_role("region", name="Running").locator("tr[data-command]")
        await expect(running).to_have_count(2)
        await expect(running.first).to_have_attribute("data-command", made[0])
        assert await running.first.evaluate(_SLIDES) == made[1]
        await page.evaluate(_AT_ONCE)
        await page.keyboard.press("F9")
        reset = page.get_by_test_id("estop-reset")
        await expect(reset).to_be_enabled()
        assert await page.evaluate("pressed")
        await expect(page.get_by_test_id("estop-active")).to_be_visible()
        await reset.click()
        await expect(page.get_by_test_id("estop-active")).to_have_count(0)
