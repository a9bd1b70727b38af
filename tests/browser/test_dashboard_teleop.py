"""Robots moved by hand on the dashboard: gamepads, drones, joints, with a real browser and the real demo."""

from __future__ import annotations

import re
from collections.abc import AsyncGenerator

import httpx
import pytest
from playwright.async_api import Browser, Page, expect

from browser.input_helpers import UNSEEN, held, take, unsafe
from browser.robots import STILL, speed, until
from browser.watched import Watched, signed_in
from docs.demo import Demo

pytestmark = [pytest.mark.anyio, pytest.mark.paired]
expect.set_options(timeout=60_000)  # ms
FLIGHT = 90.0  # s until a drone that was just switched on hangs in the air


@pytest.fixture
async def tab(browser: Browser, running: Demo) -> AsyncGenerator[Watched]:
    """Open the demo's dashboard as the operator, with gamepads of our own."""
    async with signed_in(browser, running.url, running.key, "demo-operator", UNSEEN) as found:
        yield found


async def enable_head(page: Page) -> None:
    """Switch the head on; its motors are simulated, and late where the machine is busy."""
    status = page.get_by_test_id("action-status")
    for _ in range(5):
        await page.get_by_role("button", name="Enable head").click()
        await expect(status).to_contain_text(re.compile("completed|rejected|failed"))
        if "completed" in (await status.text_content() or ""):
            return
    pytest.fail(f"the head is not to be enabled: {await status.text_content()}")


async def test_a_gamepad_drives_with_its_shoulder_held_and_stops_when_it_is_unplugged(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = await take(tab, "rover-alpha")
    odometry = "/tenant/alpha/sensor/odometry"
    await page.evaluate("hold([0, -1, 0, 0], false)")
    await expect(page.get_by_test_id("pad")).to_contain_text("Test Pad")
    await expect(page.get_by_test_id("deadman")).to_contain_text("released")
    await page.evaluate("hold([0, -1, 0, 0], true)")
    await until(robot, odometry, lambda found: found["twist"]["linear"]["x"] > 0.1)
    await expect(page.get_by_test_id("deadman")).to_contain_text("gamepad")
    await page.evaluate("hold([0, 0, -1, 0], true)")  # the right stick turns what has no sideways
    await until(robot, odometry, lambda found: found["twist"]["angular"]["z"] > 0.1)
    await tab.shoot("teleop-gamepad")
    await page.evaluate("window.pads = []")
    await expect(page.get_by_test_id("deadman")).to_contain_text("released")
    await until(robot, odometry, lambda found: speed(found) < STILL)
    commanded = await until(robot, "/tenant/alpha/actuator/cmd_vel", bool)
    assert commanded["linear"]["x"] == commanded["angular"]["z"] == 0


async def test_joints_move_while_a_slider_is_held_and_stay_where_it_is_let_go(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = await take(tab, "head-delta")
    joints = "/tenant/delta/sensor/head/joints"
    await enable_head(page)
    slider = page.get_by_role("slider", name="pan in rad")
    box = await slider.bounding_box()
    assert box is not None
    middle = box["y"] + box["height"] / 2
    await page.mouse.move(box["x"] + box["width"] / 2, middle)
    await page.mouse.down()
    await page.mouse.move(box["x"] + box["width"] * 0.75, middle, steps=4)
    await until(robot, joints, lambda found: found["positions"]["pan"] > 0.5)
    await tab.shoot("teleop-joints")
    await page.mouse.up()
    await until(robot, joints, lambda found: abs(found["velocities"]["pan"]) < STILL)
    await slider.focus()
    before = (await until(robot, joints, bool))["positions"]["pan"]
    await page.keyboard.down("PageDown")
    await until(robot, joints, lambda found: found["positions"]["pan"] < before - 0.05)
    await page.keyboard.up("PageDown")
    await page.get_by_role("button", name="Show individual joints").click()
    panel = page.locator('[data-joints="/tenant/delta/actuator/tilt/position"]')
    tilt = panel.get_by_role("slider")  # without a dead-man: it goes there when it is let go
    await expect(panel).to_contain_text(
        re.compile(r"is -?\d")
    )  # steps go from where it is known to be
    await tilt.focus()
    before = (await until(robot, joints, bool))["positions"]["tilt"]
    await page.keyboard.press("PageUp")
    await until(robot, joints, lambda found: found["positions"]["tilt"] > before + 0.05)
    await page.get_by_role("button", name="Disable head").click()


async def test_a_joint_moves_by_a_press_on_its_slider_alone_and_from_where_it_is_known_to_be(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = await take(tab, "head-delta")
    joints = "/tenant/delta/sensor/head/joints"
    await enable_head(page)
    panel = page.locator('[data-joints="/tenant/delta/actuator/head/joints"]')
    slider = panel.get_by_role("slider", name="pan in rad")
    before = (await until(robot, joints, bool))["positions"]["pan"]
    await slider.evaluate("""(slider) => {
        slider.value = 2;
        slider.dispatchEvent(new Event("input", { bubbles: true }));
    }""")
    await expect(panel).to_contain_text("hold to move")
    assert abs(float(await slider.input_value()) - before) < 0.1
    await slider.hover()
    await page.mouse.down(button="right")
    await expect(panel).to_contain_text("hold to move")
    await page.mouse.up(button="right")
    await slider.focus()
    for told in ("tell(slider, 'pointermove', 2)", "tell(window, 'contextmenu', 1)"):
        await slider.hover()
        await page.mouse.down()
        await expect(panel).to_contain_text("held")
        await slider.evaluate(f"(slider) => {told}")
        await expect(panel).to_contain_text("hold to move")
        await page.mouse.up()
    await panel.get_by_role("slider", name="tilt in rad").hover()
    await page.mouse.down()  # it takes the focus from the first, and stays pressed
    await page.mouse.move(0, 0, steps=2)
    await expect(panel.get_by_role("slider", name="tilt in rad")).to_be_focused()
    await expect(panel).to_contain_text("held")
    await page.mouse.up()
    await expect(panel).to_contain_text("hold to move")
    here = await until(robot, joints, lambda found: abs(found["velocities"]["pan"]) < STILL)
    await page.evaluate("stall()")
    await expect(panel).to_contain_text("was")
    await slider.focus()
    await page.keyboard.down("PageUp")
    await expect(panel).to_contain_text("hold to move")
    await page.keyboard.up("PageUp")
    await page.evaluate("goOn()")
    there = await until(robot, joints, lambda found: abs(found["velocities"]["pan"]) < STILL)
    assert abs(there["positions"]["pan"] - here["positions"]["pan"]) < 0.05
    await page.get_by_role("button", name="Disable head").click()


async def test_a_speed_that_nothing_ends_is_not_set_by_a_slider(
    browser: Browser, running: Demo
) -> None:
    actuators = "/tenant/delta/actuator"
    script = unsafe(f"{actuators}/pan/velocity")
    async with signed_in(browser, running.url, running.key, "demo-operator", script) as tab:
        await tab.open("teleop?robot=head-delta")
        await tab.page.get_by_role("button", name="Show individual joints").click()
        await expect(tab.page.locator(f'[data-joints="{actuators}/tilt/velocity"]')).to_be_visible()
        await expect(tab.page.locator(f'[data-joints="{actuators}/pan/velocity"]')).to_have_count(0)


async def test_a_drone_takes_off_climbs_by_key_and_lands_by_buttons(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    page = await take(tab, "drone-gamma")
    status, actions = page.get_by_test_id("action-status"), page.get_by_test_id("actions")
    for stick in await page.get_by_test_id("stick").all():  # each mark where the stick leads to
        marks = [
            await stick.get_by_text(one, exact=True).bounding_box() for one in ("left", "right")
        ]
        assert marks[0] is not None
        assert marks[1] is not None
        assert marks[0]["x"] < marks[1]["x"]
    await until(robot, "/tenant/gamma/sensor/prearm", lambda found: found["ready"], FLIGHT)
    await actions.get_by_role("button", name="Mode").click()
    await expect(status).to_contain_text("Mode: completed")
    async with held(actions.get_by_role("button", name="Arm", exact=True)):
        await expect(status).to_contain_text("Arm: completed")
    await actions.get_by_label("altitude of Take off").fill("3")
    async with held(actions.get_by_role("button", name="Take off")):
        await expect(status).to_contain_text("Take off:")
    await expect(status).to_contain_text("Take off: completed", timeout=FLIGHT * 1000)
    place = "/tenant/gamma/sensor/position/global"
    height = (await until(robot, place, bool))["relative_alt"]
    await page.keyboard.down("Shift")
    await page.keyboard.down("r")
    await until(robot, place, lambda found: found["relative_alt"] > height + 0.7)
    await expect(page.get_by_test_id("deadman")).to_contain_text("keyboard")
    await page.keyboard.up("r")
    await page.keyboard.down("q")
    sideways = "/tenant/gamma/actuator/cmd_vel"
    await until(
        robot, sideways, lambda found: found["linear"]["y"] > 0.1 and found["linear"]["z"] == 0
    )
    await tab.shoot("teleop-drone")
    await page.keyboard.up("Shift")
    await page.keyboard.up("q")
    await until(robot, sideways, lambda found: found["linear"]["y"] == found["linear"]["z"] == 0)
    await page.evaluate("hold([0, 0, -1, -1], true)")  # the right stick
    await until(
        robot, sideways, lambda found: found["linear"]["y"] > 0.1 and found["linear"]["z"] > 0.1
    )
    await page.evaluate("pads = []")
    await until(robot, sideways, lambda found: found["linear"]["y"] == found["linear"]["z"] == 0)
    await actions.get_by_role("button", name="Land").click()
    await expect(status).to_contain_text("Land:")
