"""Goals that are set by a press on the scene or the map: sent where somebody pressed, and nowhere else."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from typing import Any

import httpx
import pytest
from playwright.async_api import Browser, Page, expect

from browser.input_helpers import touching
from browser.machines import Machines, key_of, machines, person
from browser.watched import Watched

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
_BOUND = 60.0  # s


@pytest.fixture(scope="module")
async def running() -> AsyncGenerator[Machines]:
    async with machines() as made:
        yield made


@pytest.fixture
def told(running: Machines) -> Machines:
    """Return what machines are told in this test."""
    running.forget()
    return running


class Floor:
    """What is pressed on: the scene or the map, with places in metres from its middle."""

    def __init__(self, page: Page, box: Any, metre: float) -> None:
        self.page = page
        self._middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self._metre = metre

    def at(self, x: float, y: float) -> tuple[float, float]:
        return self._middle[0] + x * self._metre, self._middle[1] - y * self._metre

    async def aim(self) -> None:
        """Begin to set a goal, unless it was begun already."""
        button = self.page.get_by_test_id("aim")
        if await button.get_attribute("aria-pressed") == "false":
            await button.click()
        await expect(button).to_have_attribute("aria-pressed", "true")

    async def press(self, x: float, y: float) -> None:
        await self.page.mouse.move(*self.at(x, y))
        await self.page.mouse.down()

    async def go(self, x: float, y: float) -> None:
        await self.aim()
        await self.page.mouse.click(*self.at(x, y))


async def scene(tab: Watched) -> Floor:
    shown = tab.page.get_by_test_id("scene")
    await expect(tab.page.get_by_test_id("where")).to_contain_text("in map")
    box = await shown.bounding_box()
    assert box is not None
    return Floor(tab.page, box, box["height"] / 24)


async def earth(tab: Watched) -> Floor:
    shown = tab.page.get_by_test_id("map")
    await expect(shown).to_have_attribute("data-tracks", "2")
    return Floor(tab.page, await shown.bounding_box(), 4)


async def until(so: Callable[[], bool]) -> None:
    async with asyncio.timeout(_BOUND):
        while not so():  # noqa: ASYNC110 - the machine is in this process
            await asyncio.sleep(0.02)


async def _spoilt(floor: Floor) -> None:
    """Press as if to set a goal, in every way that something else comes between."""
    page, mouse = floor.page, floor.page.mouse
    await floor.aim()
    await mouse.click(*floor.at(3, 3), button="right")
    await floor.aim()
    await floor.press(3, 3)
    await mouse.down(button="right")
    await mouse.up(button="right")
    await mouse.up()
    await floor.aim()
    await floor.press(3, 3)
    await page.keyboard.press("Escape")
    await mouse.up()
    await floor.aim()
    await floor.press(3, 3)
    await page.get_by_role("main").dispatch_event("blur")
    await page.evaluate("window.dispatchEvent(new Event('blur'))")
    await mouse.up()
    await floor.aim()
    await floor.press(3, 3)
    await mouse.move(20, 300, steps=3)
    await mouse.up()
    async with touching(page) as two:
        await floor.aim()
        await two.down(0, *floor.at(2, 2))
        await two.down(1, *floor.at(-2, -2))
        await two.move(a=floor.at(4, 4), b=floor.at(-4, -4))
        await two.up(1)
        await two.up(0)


async def test_only_a_whole_press_on_the_floor_of_the_scene_sends_a_robot_there(
    browser: Browser, told: Machines
) -> None:
    async with person(browser, told, "otto", "scene?robot=one") as tab:
        floor = await scene(tab)
        await floor.aim()
        await tab.page.get_by_role("checkbox", name="trail").click()
        await tab.page.get_by_test_id("layers").locator("summary").first.click()
        await _spoilt(floor)
        await floor.aim()
        await tab.page.get_by_role("button", name="3D").click()
        await expect(tab.page.get_by_test_id("scene")).to_have_attribute("data-drawn", "3d")
        await tab.page.get_by_role("button", name="3D").click()
        await expect(tab.page.get_by_test_id("scene")).to_have_attribute("data-drawn", "2d")
        await floor.press(2, 1)
        await tab.page.mouse.move(*floor.at(2, 3), steps=3)  # its heading, and no turn of the view
        await tab.page.mouse.up()
        await until(lambda: len(told.one) > 0)
        [(action, goal)] = told.one
        assert (action, told.two) == ("action/move_to", [])
        assert goal["position"] == pytest.approx({"x": 2, "y": 1, "z": 0}, abs=0.1)
        assert goal["yaw"] == pytest.approx(1.57, abs=0.1)


async def test_a_robot_that_is_chosen_in_the_middle_of_a_press_is_not_sent_anywhere(
    browser: Browser, told: Machines
) -> None:
    async with person(browser, told, "otto", "scene?robot=one") as tab:
        floor = await scene(tab)
        aim = tab.page.get_by_test_id("aim")
        await floor.aim()
        await expect(aim).to_contain_text("one")
        await floor.press(2, 1)
        await tab.page.evaluate("location.hash = '#/scene?robot=two'")
        await expect(tab.page.get_by_label("Robot", exact=True)).to_have_value("two")
        await tab.page.mouse.up()
        await expect(aim).to_have_attribute("aria-pressed", "false")
        await floor.aim()
        await tab.page.evaluate("location.hash = '#/scene?robot=one'")
        await expect(aim).to_have_attribute("aria-pressed", "false")
        await tab.page.mouse.click(*floor.at(2, 1))  # moves the view, no robot
        await expect(tab.page.get_by_test_id("where")).to_contain_text("in map")
        await floor.go(-1, 0)
        await until(lambda: len(told.one) > 0)
        assert (len(told.one), told.two) == (1, [])
        assert told.one[0][1]["position"]["x"] == pytest.approx(-1, abs=0.1)


async def test_only_a_click_on_the_map_sends_a_robot_there_and_only_the_one_that_is_named(
    browser: Browser, told: Machines
) -> None:
    async with person(browser, told, "otto", "map") as tab:
        floor = await earth(tab)
        choice = tab.page.get_by_label("Action for the goal")
        await choice.select_option(label="beta/action/go_to")
        await _spoilt(floor)
        await floor.aim()
        await floor.press(3, 3)
        await tab.page.mouse.move(*floor.at(40, 3), steps=3)
        await tab.page.mouse.up()
        await expect(tab.page.get_by_test_id("aim")).to_contain_text("two")
        await choice.select_option(label="alpha/action/go_to")
        await expect(tab.page.get_by_test_id("aim")).to_have_attribute("aria-pressed", "false")
        await floor.go(10, 0)
        await until(lambda: len(told.one) > 0)
        [(action, goal)] = told.one
        assert (action, told.two) == ("action/go_to", [])
        assert goal["latitude"] == pytest.approx(47.5, abs=1e-5)
        assert goal["longitude"] == pytest.approx(8.5 + 10 / 75_200, abs=1e-5)


async def test_what_flies_keeps_its_height_and_a_place_of_long_ago_is_told_to_be_old(
    browser: Browser, told: Machines
) -> None:
    async with person(browser, told, "otto", "scene?robot=one") as tab:
        floor = await scene(tab)
        told.by["alpha"].come(0, 3)
        await expect(tab.page.get_by_test_id("where")).to_contain_text("3.00 m")
        await floor.go(2, 1)
        await until(lambda: len(told.one) > 0)
        assert told.one[0][1]["position"]["z"] == 3
        old = tab.page.locator("[data-stale=true]")
        await expect(old).to_contain_text("stale")
        await tab.open("map")
        await expect(old).to_have_count(2)
        told.by["alpha"].come()


async def test_where_a_robot_has_gone_no_other_one_takes_its_place(
    browser: Browser, told: Machines
) -> None:
    async with person(browser, told, "otto", "map") as tab:
        page, alpha = tab.page, told.by["alpha"]
        aim, choice = page.get_by_test_id("aim"), page.get_by_label("Action for the goal")
        await expect(choice).to_have_value("/tenant/alpha/action/go_to")
        alpha.go()
        await expect(page.get_by_test_id("map")).to_have_attribute("data-tracks", "1")
        await expect(choice).to_have_value("/tenant/alpha/action/go_to")
        await expect(aim).to_have_count(0)
        alpha.come()
        await expect(aim).to_be_visible()
        await tab.open("scene")
        robot = page.get_by_label("Robot", exact=True)
        await expect(robot).to_have_value("one")
        alpha.go()
        await expect(page.get_by_role("main")).to_contain_text("not available")
        await expect(robot).to_have_value("one")
        await expect(aim).to_have_count(0)
        alpha.come()
        assert (told.one, told.two) == ([], [])


@pytest.mark.parametrize("where", ["scene?robot=one", "map"])
async def test_a_goal_that_wants_approval_is_shown_as_it_is_and_sent_when_it_is_granted(
    browser: Browser, told: Machines, where: str
) -> None:
    async with person(browser, told, "lena", where) as tab:
        floor = await (scene(tab) if where.startswith("scene") else earth(tab))
        await floor.go(3, 2)
        await expect(tab.page.get_by_test_id("refusal")).to_have_attribute(
            "data-code", "approval_required"
        )
        kept = await tab.page.evaluate(
            "JSON.parse(document.querySelector('[data-testid=kept]').innerText)"
        )
        await tab.page.get_by_role("button", name="Ask for approval").click()
        await expect(tab.page.get_by_test_id("approval")).to_contain_text("Waiting for approval")
        await tab.shoot(f"approval-{where.partition('?')[0]}")
        assert not told.one
        headers = {"authorization": f"Bearer {key_of('ada')}"}
        async with httpx.AsyncClient(base_url=told.url, headers=headers) as ada:
            reply = (await ada.get("/rcp/v1/context/system/approvals")).json()["body"][0]
            decision = {"id": reply["approval"], "decision": "approve"}
            await ada.post("/rcp/v1/context/system/approvals", json=decision)
        await expect(tab.page.get_by_test_id("goal-status")).to_contain_text("completed")
        [(_, goal)] = told.one
        assert {name: goal[name] for name in kept} == kept
