"""What an operator does all day with one robot, on the demo: each test stands for a fault that one met."""

from __future__ import annotations

import asyncio
import json
import re

import httpx
import pytest
from playwright.async_api import Browser, Page, WebSocketRoute, expect

from browser.input_helpers import held
from browser.robots import until
from browser.watched import Watched, signed_in
from docs.demo import Demo

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
ALPHA = "/tenant/alpha"
PAN = "/tenant/delta/sensor/head/joints"
_COUNTED = """
window.counts = { observers: 0, cleared: 0, sized: 0 };
const Observer = window.ResizeObserver;
window.ResizeObserver = class extends Observer {
  constructor(...all) { super(...all); window.counts.observers += 1; }
};
const clear = CanvasRenderingContext2D.prototype.clearRect;
CanvasRenderingContext2D.prototype.clearRect = function (...all) {
  window.counts.cleared += 1;
  return clear.apply(this, all);
};
const width = Object.getOwnPropertyDescriptor(HTMLCanvasElement.prototype, "width");
Object.defineProperty(HTMLCanvasElement.prototype, "width", {
  get: width.get,
  set(value) { window.counts.sized += 1; width.set.call(this, value); },
});
"""
"""Counts what makes a canvas go blank, beside how often it is drawn."""


async def _drawn(page: Page, times: int) -> dict[str, int]:
    """Wait until a canvas was drawn so often; return what was counted."""
    async with asyncio.timeout(60):
        while True:
            counts: dict[str, int] = await page.evaluate("({...window.counts})")
            if counts["cleared"] >= times:
                return counts
            await page.evaluate("new Promise(requestAnimationFrame)")


async def form(tab: Watched, path: str, operation: str) -> Page:
    """Open the form of an operation."""
    await tab.open(f"explore?path={path}")
    await expect(tab.page.get_by_test_id(f"ask-{operation}")).to_be_visible()
    return tab.page


async def test_the_map_is_drawn_at_each_update_and_never_made_anew(
    browser: Browser, running: Demo
) -> None:
    async with signed_in(browser, running.url, running.key, "demo-operator", _COUNTED) as tab:
        await tab.open("map?robot=drone-gamma")
        await expect(tab.page.get_by_test_id("map")).to_have_attribute(
            "data-tracks", re.compile("[1-9]")
        )
        before = await _drawn(tab.page, 5)
        after = await _drawn(tab.page, before["cleared"] + 10)
        assert after["sized"] == before["sized"], "the map went blank"
        assert after["observers"] == before["observers"]


async def test_a_form_that_moves_a_robot_begins_empty_and_ends_with_its_command(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    start = await until(robot, "/tenant/beta/sensor/pose", bool)
    page = await form(tab, "/tenant/beta/action/move_to", "execute")
    ask = page.get_by_test_id("ask-execute")
    fields = ask.locator("input.num")
    assert await fields.count() > 3
    assert not [one for one in await fields.all() if await one.input_value()]
    await ask.locator("[data-pointer='/position/x'] input").fill(str(start["position"]["x"] + 0.4))
    await ask.locator("[data-pointer='/position/y'] input").fill(str(start["position"]["y"]))
    await ask.get_by_role("button", name="Dry run").click()
    await expect(ask.get_by_test_id("answer")).to_contain_text("Nothing was changed")
    await expect(ask.get_by_test_id("running")).to_have_count(0)
    await ask.get_by_role("button", name="Execute", exact=True).click()
    await expect(ask.get_by_test_id("running")).to_contain_text("running")
    await expect(ask.get_by_test_id("answer")).to_contain_text("completed")
    await expect(ask.get_by_test_id("running")).to_have_count(0)
    await expect(ask.get_by_role("button", name="Cancel")).to_have_count(0)
    await tab.open("commands")
    row = page.locator("tr[data-command]").filter(has_text="move_to").first
    await expect(row.get_by_test_id("input")).to_contain_text("position")


async def test_what_is_required_is_asked_for_before_anything_is_sent(tab: Watched) -> None:
    page = await form(tab, f"{ALPHA}/service/place_obstacle", "execute")
    ask = page.get_by_test_id("ask-execute")
    await ask.get_by_role("button", name="Execute", exact=True).click()
    await expect(ask.get_by_text("Enter a value.").first).to_be_visible()
    await expect(ask.get_by_test_id("refusal")).to_have_count(0)


async def test_a_parameter_is_edited_from_the_value_it_has(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    now = await until(robot, f"{ALPHA}/param/speed_limit", bool)
    page = await form(tab, f"{ALPHA}/param/speed_limit", "write")
    field = page.get_by_test_id("ask-write").get_by_label("value")
    await expect(field).to_have_value(f"{now:g}")


@pytest.mark.serial  # simulated motors whose messages come late are lost to their driver
async def test_a_joint_goes_to_a_number_and_by_steps_while_the_button_is_held(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = tab.page
    await tab.open("teleop?robot=head-delta")
    await page.get_by_role("button", name="Take control").click()
    await expect(page.get_by_test_id("control")).to_contain_text("You have control")
    await page.get_by_role("button", name="Enable head").click()
    await expect(page.get_by_test_id("action-status")).to_contain_text("completed")
    joints = page.locator("[data-joints]").first
    await joints.get_by_label("Target of pan in rad").fill("9")
    go = joints.get_by_role("button", name="Hold to go").first
    await expect(go).to_be_disabled()  # it is outside the range
    await joints.get_by_label("Target of pan in rad").fill("0.3")
    async with held(go):
        await until(robot, PAN, lambda found: abs(_pan(found) - 0.3) < 0.004)
        await expect(joints.get_by_title("Measured").first).to_have_text("is 0.30")
    # A step is counted from where the page saw the joint.
    await expect(joints.get_by_title("Measured").first).to_have_text("is 0.30")
    await joints.get_by_label(re.compile("^Step")).select_option(label="0.1 rad")
    more = joints.get_by_role("button", name=re.compile("pan plus"))
    await more.focus()
    await page.keyboard.down("Enter")
    await until(robot, PAN, lambda found: abs(_pan(found) - 0.4) < 0.02)
    await page.keyboard.up("Enter")
    slider = await joints.get_by_label("pan in rad", exact=True).bounding_box()
    assert slider is not None
    assert slider["width"] > 200


def _pan(joints: dict[str, dict[str, float]]) -> float:
    return joints["positions"]["pan"]


async def test_a_click_arms_no_drone_and_its_instruments_are_there(tab: Watched) -> None:
    page = tab.page
    await tab.open("teleop?robot=drone-gamma")
    arm = page.get_by_test_id("actions").locator("[data-guarded]").filter(has_text="Arm").first
    await arm.click()
    await expect(page.get_by_test_id("action-status")).to_contain_text("Press and hold")
    await arm.focus()
    await page.keyboard.press("Enter")
    await expect(page.get_by_test_id("action-status")).to_contain_text("Press and hold")
    await expect(page.get_by_role("img", name=re.compile("^Attitude: roll"))).to_be_visible()
    await expect(page.get_by_test_id("teleop-battery")).to_contain_text("%")
    await expect(page.get_by_test_id("teleop-gnss")).to_contain_text("satellites")
    await expect(page.get_by_test_id("teleop-home")).to_contain_text("m away")
    await tab.shoot("teleop-drone")


async def test_a_new_tab_is_logged_in_knows_its_own_lease_and_is_logged_out_with_the_others(
    tab: Watched,
) -> None:
    page = tab.page
    await tab.open("teleop?robot=rover-alpha")
    await page.get_by_role("button", name="Take control").click()
    await expect(page.get_by_test_id("control")).to_contain_text("You have control")
    other = await page.context.new_page()
    await other.goto(f"{tab.url}/#/teleop?robot=rover-alpha")
    await expect(other.get_by_test_id("principal")).to_have_text("demo-operator")
    await expect(other.get_by_test_id("control")).to_contain_text("another tab")
    await other.get_by_role("button", name="Log out").click()
    await expect(page.get_by_role("button", name="Log in").first).to_be_visible()


async def test_who_lost_the_connection_is_not_told_to_have_control(
    tab: Watched,
) -> None:
    page, lines = tab.page, list[WebSocketRoute]()
    down = False

    def connect(line: WebSocketRoute) -> None:
        lines.append(line)
        if not down:
            line.connect_to_server()

    await page.route_web_socket(re.compile("/rcp/v1/ws"), connect)
    await page.reload()
    await tab.open("teleop?robot=rover-alpha")
    await page.get_by_role("button", name="Take control").click()
    await expect(page.get_by_test_id("control")).to_contain_text("You have control")
    down = True
    tab.expected.append("WebSocket")
    for line in lines:
        await line.close()
    await expect(page.get_by_test_id("control")).not_to_contain_text("● You have control")


async def test_frames_of_a_bus_are_not_in_the_log_of_operators(tab: Watched) -> None:
    asked: list[str] = []
    tab.page.on(
        "websocket", lambda line: line.on("framesent", lambda data: asked.append(str(data)))
    )
    await tab.page.reload()
    await tab.open("log")
    await expect(tab.page.locator("tr[data-source]").first).to_be_visible()
    events = [one for one in asked if "/event/" in one and "/tenant/" in one]
    assert events
    assert not [one for one in events if "/tenant/delta/event/**" in one or "/frame" in one]


async def test_words_find_what_to_plot(tab: Watched) -> None:
    page = tab.page
    await tab.open("plot")
    await page.get_by_label("Path").fill("alpha battery")
    await expect(page.locator(".found button").first).to_be_visible()
    await page.get_by_label("Path").press("Enter")
    await expect(page.get_by_label("Path")).to_have_value(f"{ALPHA}/sensor/battery")
    await page.get_by_role("button", name="voltage", exact=True).click()
    await expect(page.locator("canvas").first).to_be_visible()
    await page.get_by_label("Path").fill("no such thing")
    await expect(page.get_by_text("Nothing that can be plotted")).to_be_visible()


async def test_a_scene_opens_on_a_robot_with_something_to_see(tab: Watched) -> None:
    await tab.open("scene")
    picker = tab.page.get_by_role("combobox", name="Robot")
    await expect(picker).to_have_value(re.compile("rover"))
    names = json.loads(
        await picker.evaluate("(one) => JSON.stringify([...one.options].map((o) => o.value))")
    )
    assert names == sorted(names)  # and the list is in the order of names


async def test_on_a_phone_every_page_is_in_reach(browser: Browser, running: Demo) -> None:
    async with signed_in(browser, running.url, running.key, "demo-operator") as tab:
        page = tab.page
        await page.set_viewport_size({"width": 390, "height": 844})
        await tab.open("log")
        pages = page.get_by_role("navigation", name="Pages")
        await pages.get_by_role("button", name="More").click()
        links = await pages.get_by_role("link").all()
        assert len(links) >= 9
        for one in links:
            box = await one.bounding_box()
            assert box is not None
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= 390
            assert box["height"] >= 44
        await pages.get_by_role("link", name="Map").click()
        await expect(page.get_by_role("heading", name="Map")).to_be_visible()
        await expect(pages.get_by_role("link", name="Scene")).to_be_hidden()


async def test_who_is_here_and_who_has_control_is_on_one_page(
    browser: Browser, running: Demo, tab: Watched
) -> None:
    page = tab.page
    await tab.open("teleop?robot=rover-alpha")
    await page.get_by_role("button", name="Take control").click()
    await expect(page.get_by_test_id("control")).to_contain_text("You have control")
    async with signed_in(browser, running.url, running.admin, "demo-admin") as admin:
        await admin.open("people")
        control = admin.page.locator("tr[data-lease]").filter(has_text="alpha")
        await expect(control).to_contain_text("demo-operator")
        sessions = admin.page.locator("tr[data-session]")
        await expect(sessions.filter(has_text="this page")).to_contain_text("demo-admin")
        newest = sessions.filter(
            has_text="demo-operator"
        ).last  # earlier ones may wait to be resumed
        await expect(newest).to_contain_text("connected")
