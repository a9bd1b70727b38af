"""Stopping and holding one robot, a tenant, a group and all: nobody is told of rest before it is measured."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncGenerator

import httpx
import pytest
from playwright.async_api import Browser, Locator, Page, expect

from browser.accessible import violations
from browser.input_helpers import UNSEEN, drives, push, stands, take
from browser.movers import Movers, key_of, movers, person
from browser.robots import until

pytestmark = [pytest.mark.anyio, pytest.mark.paired]
expect.set_options(timeout=60_000)  # ms
TOUCH = 43.5  # px: 44, as browsers round
MANY = 200
_WCAG = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]


@pytest.fixture
async def gateway() -> AsyncGenerator[Movers]:
    """Run three backends with four robots."""
    async with movers() as made:
        yield made


@pytest.fixture
async def robot(gateway: Movers) -> AsyncGenerator[httpx.AsyncClient]:
    """Look at the robots past the page."""
    headers = {"authorization": f"Bearer {key_of('ada')}"}
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers, timeout=60) as client:
        yield client


def card(page: Page, name: str) -> Locator:
    return page.locator(f'[data-robot="{name}"]')


async def latched(robot: httpx.AsyncClient) -> dict[str, str]:
    """Return how far each latched robot's stop has come, as the gateway says."""
    answer = await robot.get("/rcp/v1/context/system/estop")
    return {name: told["state"] for name, told in answer.json()["body"]["robots"].items()}


async def confirmed(robot: httpx.AsyncClient, *names: str) -> None:
    """Wait until just these are latched, and at rest."""
    await until(
        robot,
        "/system/estop",
        lambda found: (
            {one: told["state"] for one, told in found["robots"].items()}
            == dict.fromkeys(names, "confirmed")
        ),
    )


async def test_one_robot_is_stopped_and_reset_by_itself_with_the_keyboard(
    browser: Browser, gateway: Movers, robot: httpx.AsyncClient
) -> None:
    for mover in gateway.by.values():
        for part in mover.names:
            mover.tell(part, 0.7)
    async with person(browser, gateway, "ada") as tab:
        page = tab.page
        stop = page.get_by_role("button", name="Stop near", exact=True)
        await stop.focus()
        await page.keyboard.press("Enter")
        await expect(card(page, "near")).to_contain_text("stopped, at rest")
        await expect(card(page, "near").get_by_test_id("latched")).to_contain_text(
            re.compile(r"requested [\d:]+.*→ sent \+\d+ ms.*→ at rest \+\d+ ms")
        )
        await confirmed(robot, "near")
        assert gateway.by["near"].speeds == {None: 0.0}
        assert set(gateway.by["pair"].speeds.values()) == {0.7}
        await expect(page.get_by_test_id("stop-progress")).to_have_text("near is at rest.")
        await expect(card(page, "pair")).not_to_contain_text("E-stop")
        reset = card(page, "near").get_by_role("button", name="Reset near")
        await reset.focus()
        await page.keyboard.press("Enter")
        await expect(page.get_by_test_id("estop-active")).to_have_count(0)
        assert await latched(robot) == {}


async def test_one_of_several_robots_of_a_backend_is_stopped_alone(
    browser: Browser, gateway: Movers, robot: httpx.AsyncClient
) -> None:
    async with person(browser, gateway, "ada") as tab:
        page = tab.page
        gateway.by["pair"].tell("right", 0.7)
        await card(page, "pair").get_by_text("Each of its 2 robots").click()
        await page.get_by_role("button", name="Stop left", exact=True).click()
        await confirmed(robot, "pair/left")
        assert gateway.by["pair"].speeds["right"] == 0.7
        await page.get_by_role("button", name="Stop pair", exact=True).click()
        await confirmed(robot, "pair/left", "pair/right")
        assert gateway.by["pair"].speeds["right"] == 0
        await expect(card(page, "pair").get_by_test_id("latched")).to_contain_text("right")


async def test_who_is_not_confirmed_is_named_and_not_called_stopped(
    browser: Browser, gateway: Movers, robot: httpx.AsyncClient
) -> None:
    far = gateway.by["far"]
    far.tell(None, 0.7)
    far.lose()
    async with person(browser, gateway, "ada") as tab:
        page, posts = tab.page, list[str]()
        page.on("request", lambda one: posts.append(one.url) if one.method == "POST" else None)
        await page.get_by_test_id("estop").click()
        missing = page.get_by_test_id("stop-missing")
        await expect(missing).to_have_text("Not confirmed: far: use its own emergency stop.")
        await expect(page.get_by_test_id("stop-progress")).to_have_text("3 of 4 robots at rest.")
        await expect(card(page, "far")).to_contain_text("stop requested, not sent")
        await expect(card(page, "far")).to_contain_text("no message received for 4.2 s")
        await expect(card(page, "far")).not_to_contain_text("at rest +")
        await expect(card(page, "far")).not_to_contain_text("stopped")
        await tab.shoot("stop-unreachable")
        await expect(page.get_by_test_id("estop")).to_contain_text("4 robots")  # it was answered
        assert not posts  # a second stop would undo a reset
        far.obeys = False  # it is heard again, and does not brake
        far.find()
        await expect(card(page, "far")).to_contain_text("stop sent, not at rest")
        await expect(card(page, "far")).not_to_contain_text("stopped")
        await expect(missing).to_be_visible()
        far.obeys = True
        await expect(card(page, "far")).to_contain_text("stopped, at rest")
        await expect(missing).to_have_count(0)
        await expect(page.get_by_test_id("stop-progress")).to_have_text("All 4 robots are at rest.")
        # The request itself had failed meanwhile: the banner has said so, nothing else lies over it.
        await expect(page.get_by_test_id("stop-problem")).to_have_count(0)


@pytest.mark.parametrize("who", ["ada", "otto"])
async def test_a_robot_that_moves_again_is_an_alarm_everywhere(
    browser: Browser, gateway: Movers, robot: httpx.AsyncClient, who: str
) -> None:
    near = gateway.by["near"]
    async with person(browser, gateway, who) as tab:  # otto does not see the gateway's log
        page = tab.page
        await page.get_by_role("button", name="Stop near", exact=True).click()
        await confirmed(robot, "near")
        near.obeys = False
        near.tell(None, 0.3)
        alarm = page.get_by_test_id("stop-alarm")
        await expect(alarm).to_contain_text("near is moving despite the stop")
        await expect(page.get_by_role("alert").filter(has_text="ALARM")).to_be_visible()
        await expect(card(page, "near")).to_contain_text("ALARM: moving")
        await expect(page).to_have_title(re.compile("ALARM"))  # for who looks at another tab
        words = "ALARM: near is moving despite the emergency stop: moves at 0.3 m/s"
        await expect(page.get_by_role("region", name="Warnings", exact=True)).to_contain_text(words)
        await tab.shoot("stop-alarm")
        await tab.open("log")
        await expect(page.get_by_role("region", name="Entries")).to_contain_text(words)
        await expect(alarm).to_be_visible()
        near.obeys = True
        await expect(alarm).to_have_count(0)
        banner = page.get_by_test_id("estop-active")
        await expect(banner).to_contain_text("near is at rest.")
        await expect(banner).to_contain_text("it moved again during the stop")


async def test_hold_brings_one_robot_to_rest_without_a_latch(
    browser: Browser, gateway: Movers, robot: httpx.AsyncClient
) -> None:
    near, right = gateway.by["near"], gateway.by["pair"]
    near.tell(None, 0.7)
    right.tell("right", 0.7)
    async with person(browser, gateway, "otto") as tab:
        page = tab.page
        await page.get_by_role("button", name="Hold near", exact=True).press("Enter")
        status_text = card(page, "near").get_by_test_id("hold-status")
        await expect(status_text).to_contain_text("near: at rest")
        assert near.speeds == {None: 0.0}
        assert near.holds
        assert right.speeds["right"] == 0.7
        assert await latched(robot) == {}
        near.obeys = False
        near.tell(None, 0.2)
        await page.get_by_role("button", name="Hold near", exact=True).click()
        await expect(card(page, "near")).to_contain_text("near is not confirmed at rest")
        await expect(status_text).not_to_contain_text("at rest.")


async def test_who_drives_and_holds_or_stops_moves_it_again_by_a_new_press_alone(
    browser: Browser, gateway: Movers, robot: httpx.AsyncClient
) -> None:
    near = gateway.by["near"]
    async with person(browser, gateway, "ada", "teleop?robot=near", UNSEEN) as tab:
        page = await take(tab, "near")
        await page.evaluate("hold([0, -1, 0, 0], true)")
        await drives(page, "gamepad")
        await asyncio.wait_for(near.driven.wait(), 60)
        await page.get_by_role("button", name="Hold near", exact=True).press("Enter")
        await stands(page)
        await expect(page.get_by_test_id("hold-status")).to_contain_text("near: at rest")
        await expect(page.get_by_test_id("spent")).to_contain_text("gamepad")
        assert near.speeds == {None: 0.0}
        await page.evaluate("hold([0, 0, 0, 0], false)")
        await expect(page.get_by_test_id("spent")).to_have_count(0)
        await push(page)
        await drives(page, "stick")
        await page.get_by_role("button", name="Stop near", exact=True).press("Enter")
        await stands(page)
        await confirmed(robot, "near")
        await expect(page.get_by_test_id("control")).to_contain_text("Emergency stop")
        await page.mouse.up()


async def test_a_tenant_a_group_or_all_are_stopped_from_the_menu(
    browser: Browser, gateway: Movers, robot: httpx.AsyncClient
) -> None:
    async with person(browser, gateway, "ada") as tab:
        page = tab.page
        everything = page.get_by_test_id("estop")
        await expect(everything).to_have_text(re.compile(r"STOP ALL\s+4 robots"))
        await expect(everything).to_have_attribute(
            "title", re.compile(r"all 4 robots visible to you, in alpha, beta, gamma")
        )
        menu = page.get_by_role("group", name="What to stop")

        async def stops(label: str, *names: str) -> None:
            await page.get_by_test_id("stop-menu").press("Enter")
            await menu.get_by_role("button", name=label).press("Enter")
            await expect(menu).to_have_count(0)
            await confirmed(robot, *names)
            await page.get_by_test_id("estop-reset").press("Enter")
            await expect(page.get_by_test_id("estop-active")).to_have_count(0)

        await stops("Stop tenant beta", "pair/left", "pair/right")
        await stops("Stop group cell", "near", "pair/left")
        await stops("Stop all", "near", "far", "pair/left", "pair/right")
        await page.get_by_test_id("stop-menu").press("Enter")
        await page.keyboard.press("Escape")
        await expect(menu).to_have_count(0)
        await expect(page.get_by_test_id("stop-menu")).to_be_focused()
        assert await latched(robot) == {}


async def test_the_button_says_and_stops_what_the_role_may(
    browser: Browser, gateway: Movers, robot: httpx.AsyncClient
) -> None:
    async with person(browser, gateway, "local") as tab:
        page = tab.page
        button = page.get_by_test_id("estop")
        await expect(button).to_have_text(re.compile(r"STOP alpha\s+1 robot"))
        await expect(button).to_have_attribute("title", re.compile("1 robot of your tenant alpha"))
        await page.get_by_test_id("stop-menu").click()
        menu = page.get_by_role("group", name="What to stop")
        await expect(menu.get_by_role("button", name="Stop all")).to_have_count(0)
        await expect(menu.get_by_role("button", name="Stop tenant beta")).to_be_visible()
        await page.keyboard.press("F9")
        await confirmed(robot, "near")
        # Nor may this role reset anything.
        await expect(page.get_by_test_id("estop-active")).to_contain_text("may not reset it")
        await expect(page.get_by_role("button", name=re.compile("^Reset"))).to_have_count(0)


async def test_reset_is_there_for_those_who_may_where_they_may(
    browser: Browser, gateway: Movers, robot: httpx.AsyncClient
) -> None:
    stop = {"type": "execute", "path": "/system/estop", "body": {}}
    async with person(browser, gateway, "half") as tab:
        page = tab.page
        assert (await robot.post("/rcp/v1/messages", json=stop)).json()["status"] == "completed"
        await expect(page.get_by_test_id("estop-active")).to_be_visible()
        await expect(page.get_by_test_id("estop-reset")).to_have_count(0)
        await expect(card(page, "near").get_by_role("button", name="Reset near")).to_be_visible()
        await expect(card(page, "pair")).to_contain_text("stopped, at rest")
        await expect(card(page, "pair").get_by_role("button", name="Reset")).to_have_count(0)
        await page.get_by_test_id("stop-details").click()
        rows = page.get_by_role("region", name="Stopped robots, one by one").locator("tr")
        await rows.filter(has_text="near").get_by_role("button", name="Reset near").press("Enter")
        await confirmed(robot, "pair/left", "pair/right", "far")


async def test_a_command_that_the_link_cut_off_says_what_becomes_of_the_robot(
    browser: Browser, gateway: Movers
) -> None:
    path = "/tenant/alpha/action/go"
    async with person(browser, gateway, "otto", f"explore?path={path}") as tab:
        form = tab.page.get_by_test_id("ask-execute")
        await form.get_by_role("button", name="Execute", exact=True).click()
        await expect(form.get_by_test_id("running")).to_be_visible()
        gateway.by["near"].lose()
        words = "the gateway commands it to hold when the link is restored"
        await expect(form.get_by_test_id("refusal")).to_contain_text(words)
        await tab.open("commands")
        await expect(tab.page.get_by_role("main")).to_contain_text(words)


async def small(page: Page) -> list[str]:
    """Return the buttons that stop, hold or reset and are too small for a finger."""
    found: list[str] = await page.evaluate(
        "(least) => [...document.querySelectorAll('button')]"
        ".filter((one) => /stop|hold|reset|details/i.test(one.textContent) && one.checkVisibility())"
        ".filter((one) => Math.min(one.offsetHeight, one.offsetWidth) < least)"
        ".map((one) => one.outerHTML.slice(0, 120))",
        TOUCH,
    )
    return found


async def test_while_robots_are_stopped_everybody_can_use_the_page(
    browser: Browser, gateway: Movers, axe: str
) -> None:
    gateway.by["far"].lose()
    async with person(browser, gateway, "ada") as tab:
        page = tab.page
        await page.evaluate(axe)
        wrong: list[str] = []
        for theme in ("dark", "light"):
            await page.evaluate(
                "(theme) => (document.documentElement.dataset.theme = theme)", theme
            )
            await page.get_by_test_id("stop-menu").click()
            wrong += [f"menu: {one}" for one in await violations(page, _WCAG)]
            await page.keyboard.press("Escape")
            await page.get_by_test_id("estop").click()
            await expect(page.get_by_test_id("stop-missing")).to_be_visible()
            await page.get_by_test_id("stop-details").click()
            wrong += [f"{theme}: {one}" for one in await violations(page, _WCAG)]
            assert not await small(page)
            await tab.shoot(f"stop-details-{theme}")
            await page.get_by_test_id("estop-reset").press("Enter")
            await expect(page.get_by_test_id("estop-active")).to_have_count(0)
        assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (390, 844)])
async def test_reset_is_in_view_however_many_robots_are_stopped(
    browser: Browser, width: int, height: int
) -> None:
    async with movers(MANY) as gateway, person(browser, gateway, "ada") as tab:
        page = tab.page
        await page.set_viewport_size({"width": width, "height": height})
        for name in ("robot-000", "robot-100", "robot-101", "robot-102", "robot-103", "robot-104"):
            gateway.by[name].lose()
        await expect(page.get_by_test_id("estop")).to_contain_text(f"{MANY} robots")
        await page.get_by_test_id("estop").click()
        missing = page.get_by_test_id("stop-missing")
        await expect(missing).to_contain_text(
            "robot-000, robot-100, robot-101, robot-102 and 2 more"
        )
        reset = page.get_by_test_id("estop-reset")
        await expect(reset).to_be_in_viewport(ratio=1)
        banner = await page.get_by_test_id("estop-active").bounding_box()
        assert banner is not None
        assert banner["height"] < height / 3
        assert not await small(page)
        await tab.shoot(f"stop-many-{width}")
        await page.get_by_test_id("stop-details").click()
        rows = page.get_by_role("region", name="Stopped robots, one by one")
        await expect(rows.locator("tr[data-latch]").first).to_have_attribute(
            "data-latch", "robot-000"
        )
        await expect(reset).to_be_in_viewport(ratio=1)
        await expect(page.get_by_test_id("estop")).to_be_in_viewport(ratio=1)
        await rows.locator("tr[data-latch]").nth(MANY - 1).scroll_into_view_if_needed()
        await expect(reset).to_be_in_viewport(ratio=1)
        await tab.shoot(f"stop-many-{width}-details")
