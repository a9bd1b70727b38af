"""A robot moves while a hand is on it and by nothing else, with a real browser and a real gateway."""

from __future__ import annotations

import re
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import httpx
import pytest
from playwright.async_api import Browser, Page, expect

from browser.driving import KEYS, PAD, STICK, Hand, set_going
from browser.input_helpers import UNSEEN, drives, push, shift, stands, take, unsafe
from browser.robots import STILL, speed, until
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
    + backend("other", "beta", use="sim")
    + role("learner", rule("*", "/**", "/system/leases", "/system/estop"), priority=10)
    + "".join(key(n, f"key-of-{n}-which-is-long", role=held) for n, held in PEOPLE.items())
)
ODOMETRY = "/tenant/alpha/sensor/odometry"
CMD_VEL = "/tenant/alpha/actuator/cmd_vel"


@pytest.fixture(scope="module")
async def url() -> AsyncGenerator[str]:
    """Run a gateway with two rovers in this process; yield its address."""
    configure("error", "json")
    async with serve(parse(GATEWAY, "test")) as served:
        yield next(facts["url"] for facts in served.server.status.transports if "url" in facts)


@pytest.fixture
async def robot(url: str) -> AsyncGenerator[httpx.AsyncClient]:
    """Look at the rovers past the page."""
    headers = {"authorization": "Bearer key-of-ada-which-is-long"}
    async with httpx.AsyncClient(base_url=url, headers=headers, timeout=60) as client:
        await until(client, "/system/leases", lambda found: not found)
        yield client


SELDOM = """
() => {
  const every = window.setInterval;
  window.setInterval = (look, ms, ...more) => every(look, ms === 50 ? 5000 : ms, ...more);
}
"""
"""Has the page look at gamepads so seldom that control is taken before the second look."""


@asynccontextmanager
async def person(browser: Browser, url: str, name: str, more: str = "") -> AsyncGenerator[Watched]:
    """Open the dashboard as one of the people."""
    key = f"key-of-{name}-which-is-long"
    async with signed_in(browser, url, key, name, UNSEEN + more) as tab:
        yield tab


@pytest.fixture
async def tab(browser: Browser, url: str) -> AsyncGenerator[Watched]:
    """Open the dashboard as the operator."""
    async with person(browser, url, "otto") as found:
        yield found


async def moves(page: Page, hand: Hand, robot: httpx.AsyncClient) -> None:
    """Have the rover move."""
    await set_going(page, hand, robot, ODOMETRY)


async def rests(robot: httpx.AsyncClient) -> None:
    """Wait until the rover rests, and nothing else is wanted of it."""
    await until(robot, ODOMETRY, lambda found: speed(found) < STILL)
    await until(robot, CMD_VEL, lambda found: found["angular"]["z"] == 0)


async def spent(page: Page, source: str) -> None:
    """Wait until the page says what has to be let go first."""
    await expect(page.get_by_test_id("spent")).to_contain_text(source)


async def test_a_gamepad_drives_nothing_while_nobody_is_at_the_page_nor_before_a_new_press(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = await take(tab, "rover")
    await moves(page, PAD, robot)
    await page.evaluate("leave()")
    await stands(page)
    await rests(robot)
    await page.evaluate("comeBack()")
    await spent(page, "gamepad")
    await rests(robot)
    await page.evaluate("hold([-1, 0, 0, 0], false)")
    await expect(page.get_by_test_id("spent")).to_have_count(0)
    await moves(page, PAD, robot)
    await page.evaluate("""
        const dialog = document.createElement("dialog");
        document.body.append(dialog);
        dialog.showModal();
    """)
    await stands(page)
    await rests(robot)
    await page.evaluate("hold([-1, 0, 0, 0], true, '')")
    await expect(page.get_by_test_id("pad")).to_contain_text("cannot be used to drive")


async def test_keys_that_drive_change_no_limit_and_none_drives_that_was_let_go_unseen(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = await take(tab, "rover")
    limit = page.get_by_role("slider", name="Speed limit")
    before = await limit.input_value()
    await limit.focus()
    await moves(page, KEYS, robot)
    await page.keyboard.down("ArrowLeft")  # it repeats
    await page.keyboard.press("PageDown")
    await page.keyboard.up("Shift")
    await page.keyboard.down("ArrowLeft")  # it still does
    await stands(page)
    assert await limit.input_value() == before
    await page.keyboard.up("ArrowLeft")
    await page.keyboard.press("ArrowLeft")
    assert await limit.input_value() != before
    await page.keyboard.down("Shift")
    await page.keyboard.down("a")
    await drives(page, "keyboard")
    await page.evaluate("window.dispatchEvent(new Event('blur'))")
    await stands(page)
    await page.keyboard.down("Shift")  # both repeat
    await page.keyboard.down("a")
    await page.keyboard.up("a")
    await page.keyboard.down("a")
    await stands(page)
    await page.keyboard.up("Shift")
    await page.keyboard.down("Shift")
    await drives(page, "keyboard")
    await page.keyboard.down("Control")  # of what is let go beside it nobody tells
    await stands(page)
    await page.keyboard.up("Control")
    for told in ("tell(document.body, 'dragstart', 1)", "document.querySelector('select').focus()"):
        await page.keyboard.up("Shift")
        await page.evaluate("document.activeElement.blur()")
        await page.keyboard.down("Shift")
        await drives(page, "keyboard")
        await page.evaluate(told)
        await stands(page)
    await rests(robot)


LET_GO = [
    "tell(stick, 'pointermove', 0)",
    "tell(stick, 'pointermove', 2)",  # the other button alone
    "tell(stick, 'pointercancel', 1)",
    "tell(stick, 'lostpointercapture', 1)",
    "tell(window, 'blur', 1)",
    "tell(window, 'resize', 1)",  # zoomed, or turned
    "tell(document.body, 'contextmenu', 1)",
]


async def test_a_stick_does_not_outlive_the_hand_on_it(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = await take(tab, "rover")
    stick = page.get_by_test_id("stick")
    await push(page, "right")
    await shift(page)
    await stands(page)
    await page.mouse.up(button="right")
    for told in LET_GO:
        await push(page)
        await drives(page, "stick")
        await stick.evaluate(f"(stick) => {told}")
        await stands(page)
        await shift(page)
        await stands(page)
        await page.mouse.up()
    await push(page)
    await drives(page, "stick")
    assert not await stick.evaluate("(stick) => tell(stick, 'contextmenu', 1)"), "no menu comes"
    await shift(page)
    await drives(page, "stick")
    box = await stick.bounding_box()
    assert box is not None
    await page.mouse.move(box["x"] + box["width"] * 0.4, box["y"] + box["height"] / 2)
    await page.evaluate(
        "document.querySelector('main').prepend(Object.assign(document.createElement('p'), { style: 'height: 40px' }))"
    )
    await page.mouse.move(box["x"] + box["width"] * 0.2, box["y"] + box["height"] / 2)
    wanted = await until(robot, CMD_VEL, lambda found: found["angular"]["z"] > 0.47)
    assert abs(wanted["linear"]["x"]) < 0.01, "what shifts below the hand steers"
    await page.get_by_role("link", name="Overview").press("Enter")
    await rests(robot)
    await until(robot, "/system/leases", lambda found: not found)


async def test_a_drive_that_failed_goes_on_by_a_new_press_alone(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = await take(tab, "rover")
    await moves(page, STICK, robot)
    await page.evaluate("""hang('"write"')""")
    await expect(page.locator("[data-code=link_slow]")).to_be_visible()
    await page.evaluate("goOn()")
    await shift(page)
    await spent(page, "stick")
    await stands(page)
    await rests(robot)
    await page.evaluate("hold([-1, 0, 0, 0], true)")  # nor by another dead-man beside it
    await spent(page, "gamepad")
    await page.evaluate("pads = []")
    await page.mouse.up()
    await expect(page.get_by_test_id("spent")).to_have_count(0)
    await moves(page, STICK, robot)
    await page.evaluate(
        "{ const end = performance.now() + 1500; while (performance.now() < end); }"
    )
    await expect(page.locator("[data-code=held_up]")).to_be_visible()
    await shift(page)
    await stands(page)
    await rests(robot)
    await page.mouse.up()


async def test_a_lease_that_comes_when_its_page_is_left_is_given_back(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    await tab.open("teleop?robot=rover")
    button = tab.page.get_by_role("button", name="Take control")
    await expect(button).to_be_enabled()
    status_text = tab.page.get_by_test_id("action-status")
    await tab.page.get_by_role("button", name="Clear faults").click()
    await expect(status_text).to_contain_text("Clear faults")
    await tab.page.evaluate("stall()")
    await button.click()
    await until(robot, "/system/leases", bool)
    await tab.page.get_by_role("combobox", name="Robot").select_option("other")
    await expect(status_text).to_contain_text("No commands yet")  # it is another robot's
    await tab.page.evaluate("goOn()")
    await until(robot, "/system/leases", lambda found: not found)
    await expect(tab.page.get_by_test_id("control")).to_contain_text("No control")


async def test_who_waits_for_one_robot_gets_no_other(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page, leases = tab.page, "/rcp/v1/context/system/leases"
    held = {"do": "acquire", "scope": "/tenant/alpha/actuator", "ttl": 60}
    assert (await robot.post(leases, json=held)).is_success
    await tab.open("teleop?robot=rover")
    await page.get_by_role("button", name="Take control").click()
    await page.get_by_role("button", name="Take control when free").click()
    await page.get_by_role("combobox", name="Robot").select_option("other")
    await page.get_by_role("button", name="Clear faults").click()
    # What was asked of the gateway before this is answered before it.
    await expect(page.get_by_test_id("action-status")).to_contain_text("completed")
    await expect(page.get_by_test_id("control")).to_contain_text("No control")
    assert (await robot.post(leases, json={**held, "do": "release"})).is_success


async def test_control_that_was_taken_over_and_comes_back_moves_nothing_before_a_new_press(
    browser: Browser, url: str, robot: httpx.AsyncClient
) -> None:
    async with person(browser, url, "lena") as lena, person(browser, url, "otto") as otto:
        page = await take(lena, "rover")
        await moves(page, STICK, robot)
        await otto.open("teleop?robot=rover")
        await otto.page.get_by_role("button", name="Take control").click()
        await otto.page.get_by_label("Reason for taking over").fill("the hall is full")
        await otto.page.get_by_role("button", name="Take over").click()
        await stands(page)
        await rests(robot)
        await otto.page.get_by_role("button", name="Release control").click()
        await expect(otto.page.get_by_test_id("control")).to_contain_text("No control")
        await take(lena, "rover")
        await shift(page)
        await stands(page)
        await page.mouse.up()
        await moves(page, STICK, robot)
        await page.get_by_role("button", name="Log out").press("Enter")
        await rests(robot)


async def test_what_is_held_through_an_emergency_stop_or_for_another_robot_moves_nothing(
    browser: Browser, url: str, robot: httpx.AsyncClient
) -> None:
    async with person(browser, url, "ada") as tab:
        page = await take(tab, "rover")
        await moves(page, PAD, robot)
        await page.keyboard.press("F9")
        await expect(page.get_by_test_id("estop-active")).to_be_visible()
        await stands(page)
        await page.get_by_test_id("estop-reset").click()
        await expect(page.get_by_test_id("estop-active")).to_have_count(0)
        await take(tab, "rover")
        await spent(page, "gamepad")
        await stands(page)
        await page.evaluate("hold([0, 0, 0, 0], false)")
        await expect(page.get_by_test_id("spent")).to_have_count(0)
        await moves(page, PAD, robot)
        await page.evaluate(SELDOM)
        await page.get_by_role("combobox", name="Robot").select_option("other")
        await rests(robot)
        await take(tab, "other")
        await spent(page, "gamepad")
        await stands(page)
        # Nor is what was known told as if it were so now.
        await page.evaluate("stall()")
        await expect(page.get_by_test_id("latency")).to_have_text(re.compile(r"\d{4} ms"))
        await expect(page.get_by_test_id("old").first).to_be_visible()


async def test_an_emergency_stop_passes_by_a_connection_that_hangs(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = await take(tab, "rover")
    await moves(page, STICK, robot)
    await page.evaluate("hang('')")
    await rests(robot)
    stops: list[str] = []
    page.on("request", lambda one: one.method == "POST" and stops.append(one.url))
    await page.clock.install()
    try:
        async with page.expect_response("**/rcp/v1/messages") as answer:
            await page.keyboard.press("F9")
        await (await answer.value).finished()
        await until(robot, "/system/estop", lambda found: found["active"])
        await page.clock.fast_forward(3500)  # ms
        await page.evaluate("goOn()")
        assert len(stops) == 1  # another one would undo a reset
        await expect(page.get_by_test_id("estop-active")).to_be_visible()
        await page.mouse.up()
    finally:
        body = {"type": "execute", "path": "/system/estop", "body": {"reset": True}}
        await robot.post("/rcp/v1/messages", json=body)


async def test_a_key_that_is_held_presses_a_button_once(tab: Watched) -> None:
    page, sent = tab.page, list[str]()
    page.on("websocket", lambda link: link.on("framesent", lambda data: sent.append(str(data))))
    await page.reload()
    await tab.open("teleop?robot=rover")
    await page.get_by_role("button", name="Clear faults").focus()
    for _ in range(4):
        await page.keyboard.down("Enter")
    await page.keyboard.up("Enter")
    await expect(page.get_by_test_id("action-status")).to_contain_text("completed")
    requests = [one for one in sent if "clear_faults" in one and "execute" in one]
    assert len(requests) == 1


async def test_what_nothing_stops_is_not_offered_to_be_driven(browser: Browser, url: str) -> None:
    async with person(browser, url, "otto", unsafe(CMD_VEL)) as tab:
        await tab.open("teleop")
        picker = tab.page.get_by_role("combobox", name="Robot")
        await expect(picker.get_by_role("option")).to_have_text(["other (beta)"])
        await tab.open("teleop?robot=rover")  # nor another one in its place
        await expect(tab.page.get_by_text("The selected robot is not available")).to_be_visible()
        await expect(tab.page.get_by_role("button", name="Take control")).to_have_count(0)
