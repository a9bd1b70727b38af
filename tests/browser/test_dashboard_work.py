"""What people do on the dashboard, with a real browser and the real demo: look, change, drive, stop."""

from __future__ import annotations

import re

import httpx
import pytest
from playwright.async_api import Browser, Locator, Page, expect

from browser.robots import STILL, speed, until, value
from browser.watched import Watched, log_in, watched
from docs.demo import Demo

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
ALPHA = "/tenant/alpha"


async def explore(tab: Watched, path: str) -> Page:
    await tab.open(f"explore?path={path}")
    await expect(tab.page.get_by_role("heading", name=path)).to_be_visible()
    return tab.page


async def test_a_value_is_found_watched_and_written(tab: Watched, robot: httpx.AsyncClient) -> None:
    await tab.open("explore")
    await tab.page.get_by_role("searchbox", name="Search").fill("speed limit alpha")
    await tab.page.locator(f'[data-path="{ALPHA}/param/speed_limit"]').click()
    shown, form = tab.page.get_by_test_id("value"), tab.page.get_by_test_id("ask-write")
    await expect(shown).to_contain_text("m/s")
    await form.get_by_label("value").fill("0.7")
    await form.get_by_role("button", name="Write", exact=True).click()
    await expect(form.get_by_test_id("answer")).to_contain_text("completed")
    await expect(shown).to_contain_text("0.7")
    assert await value(robot, f"{ALPHA}/param/speed_limit") == 0.7
    await tab.shoot("explore-write")


async def test_what_does_not_fit_the_schema_is_not_sent(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    before = await value(robot, f"{ALPHA}/param/speed_limit")
    page = await explore(tab, f"{ALPHA}/param/speed_limit")
    form = page.get_by_test_id("ask-write")
    await form.get_by_label("value").fill("900")
    await form.get_by_role("button", name="Write", exact=True).click()
    await expect(form.get_by_role("alert")).to_be_visible()
    await expect(form.get_by_test_id("refusal")).to_have_count(0)
    await form.get_by_label("value").fill("800")
    await expect(form.get_by_role("alert")).to_be_visible()
    await form.get_by_label("value").fill("0.8")
    await expect(form.get_by_role("alert")).to_have_count(0)
    assert await value(robot, f"{ALPHA}/param/speed_limit") == before


async def test_what_the_robot_refuses_is_told_in_place_with_the_way_out(tab: Watched) -> None:
    page = await explore(tab, f"{ALPHA}/service/place_obstacle")
    form = page.get_by_test_id("ask-execute")
    await form.get_by_role("button", name="JSON").click()
    await form.get_by_label("Value as JSON").fill('{"x": 900, "y": 900, "size_x": 1, "size_y": 1}')
    await form.get_by_role("button", name="Execute", exact=True).click()
    refusal = form.get_by_test_id("refusal")
    await expect(refusal).to_contain_text("outside the warehouse")
    await expect(refusal).to_have_attribute("data-code", "device_rejected")
    await tab.shoot("explore-refused")


async def test_a_role_that_only_looks_is_offered_nothing_to_change(
    browser: Browser, running: Demo
) -> None:
    async with watched(browser, running.url) as tab:
        await tab.open(f"explore?path={ALPHA}/param/speed_limit")
        await expect(tab.page.get_by_test_id("value")).to_contain_text("m/s")
        await expect(tab.page.get_by_test_id("ask-write")).to_have_count(0)
        await tab.open("teleop")
        await expect(tab.page.get_by_text("Your role may not drive any robot here")).to_be_visible()


async def test_a_rover_is_sent_somewhere_and_arrives(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    start = await value(robot, "/tenant/beta/sensor/pose")
    goal = start["position"]["x"] + 0.5
    page = await explore(tab, "/tenant/beta/action/move_to")
    form = page.get_by_test_id("ask-execute")
    await form.get_by_role("button", name="JSON").click()
    text = f'{{"position": {{"x": {goal}, "y": {start["position"]["y"]}, "z": 0}}}}'
    await form.get_by_label("Value as JSON").fill(text)
    await form.get_by_role("button", name="Execute", exact=True).click()
    await expect(form.get_by_test_id("running")).to_be_visible()
    await expect(form.get_by_test_id("answer")).to_contain_text("completed")
    end = await value(robot, "/tenant/beta/sensor/pose")
    assert abs(end["position"]["x"] - goal) < 0.3
    await tab.open("commands")
    await expect(page.get_by_text("move_to").first).to_be_visible()
    await tab.shoot("commands")


async def take_control(tab: Watched, robot: httpx.AsyncClient) -> Locator:
    """Open Teleop as soon as no tab before it holds the rover any more."""
    await until(robot, "/system/leases", lambda found: not found)
    await tab.open("teleop?robot=rover-alpha")
    await expect(tab.page.get_by_role("combobox", name="Robot")).to_have_value("rover-alpha")
    await tab.page.get_by_role("button", name="Take control").click()
    await expect(tab.page.get_by_test_id("control")).to_contain_text("You have control")
    return tab.page.get_by_test_id("stick")


async def push(page: Page, stick: Locator) -> None:
    """Press the stick and hold it forward."""
    box = await stick.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    await page.mouse.move(x, y)
    await page.mouse.down()
    await page.mouse.move(x, y - box["height"] / 4, steps=4)


async def test_a_rover_drives_while_the_stick_is_held_and_no_longer(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    stick = await take_control(tab, robot)
    before = (await value(robot, f"{ALPHA}/sensor/pose"))["position"]
    await push(tab.page, stick)
    await until(robot, f"{ALPHA}/sensor/odometry", lambda found: speed(found) > 0.05)
    await expect(tab.page.get_by_test_id("deadman")).to_contain_text("stick")
    await tab.shoot("teleop-driving")
    await tab.page.mouse.up()
    await until(robot, f"{ALPHA}/sensor/odometry", lambda found: speed(found) < STILL)
    after = (await value(robot, f"{ALPHA}/sensor/pose"))["position"]
    assert abs(after["x"] - before["x"]) + abs(after["y"] - before["y"]) > 0.01
    await tab.page.get_by_role("button", name="Release control").click()
    await expect(tab.page.get_by_test_id("control")).to_contain_text("No control")


async def test_a_rover_stops_when_the_tab_that_drives_it_is_closed(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    stick = await take_control(tab, robot)
    await push(tab.page, stick)
    await until(robot, f"{ALPHA}/sensor/odometry", lambda found: speed(found) > 0.05)
    await tab.page.close()
    await until(robot, f"{ALPHA}/sensor/odometry", lambda found: speed(found) < STILL)
    commanded = await value(robot, f"{ALPHA}/actuator/cmd_vel")
    assert commanded["linear"]["x"] == commanded["angular"]["z"] == 0


async def test_keys_drive_only_with_the_dead_man_held(
    tab: Watched, robot: httpx.AsyncClient
) -> None:
    await take_control(tab, robot)
    keyboard = tab.page.keyboard
    await keyboard.down("ArrowUp")
    await expect(tab.page.get_by_test_id("deadman")).to_contain_text("released")
    await keyboard.down("Shift")
    await until(robot, f"{ALPHA}/sensor/odometry", lambda found: speed(found) > 0.05)
    await keyboard.up("Shift")
    await until(robot, f"{ALPHA}/sensor/odometry", lambda found: speed(found) < STILL)
    await keyboard.up("ArrowUp")


async def test_an_emergency_stop_stops_a_rover_and_only_an_admin_lets_it_go(
    tab: Watched, robot: httpx.AsyncClient, browser: Browser, running: Demo
) -> None:
    stick = await take_control(tab, robot)
    await push(tab.page, stick)
    await until(robot, f"{ALPHA}/sensor/odometry", lambda found: speed(found) > 0.05)
    await tab.page.keyboard.press("F9")
    banner = tab.page.get_by_test_id("estop-active")
    await expect(banner).to_be_visible()
    await until(robot, f"{ALPHA}/sensor/odometry", lambda found: speed(found) < STILL)
    await tab.page.mouse.up()
    await expect(banner).to_contain_text("Your role may not reset it")
    await tab.shoot("estop")
    refused = await explore(tab, "/tenant/beta/action/dock")
    await refused.get_by_role("button", name="Execute", exact=True).click()
    await expect(refused.get_by_test_id("refusal")).to_have_attribute("data-code", "estop_active")
    async with watched(browser, running.url) as other:
        await other.open()
        await other.connected()
        await expect(other.page.get_by_test_id("estop-active")).to_be_visible()
        await log_in(other.page, running.admin)
        await other.page.get_by_test_id("estop-reset").click()
        await expect(other.page.get_by_test_id("estop-active")).to_have_count(0)
    await expect(banner).to_have_count(0)
    await refused.get_by_role("button", name="Execute", exact=True).click()
    await expect(
        refused.get_by_test_id("running").or_(refused.get_by_test_id("answer"))
    ).to_be_visible()


async def test_the_button_stops_everything_too(
    tab: Watched, robot: httpx.AsyncClient, running: Demo
) -> None:
    await tab.page.get_by_test_id("estop").click()
    await expect(tab.page.get_by_test_id("estop-active")).to_contain_text(
        re.compile("everything|robots are at rest")
    )
    admin = {"authorization": f"Bearer {running.admin}"}
    body = {"type": "execute", "path": "/system/estop", "body": {"reset": True}}
    answer = await robot.post("/rcp/v1/messages", json=body, headers=admin)
    assert answer.json()["status"] == "completed"
    await expect(tab.page.get_by_test_id("estop-active")).to_have_count(0)


async def test_a_rover_out_of_reach_is_named_until_it_is_at_rest(
    tab: Watched, robot: httpx.AsyncClient, running: Demo
) -> None:
    page = tab.page
    fault = {"fault": "link_lost", "seconds": 8}
    path = "/rcp/v1/context/tenant/beta/service/inject_fault"
    assert (await robot.post(path, json=fault)).is_success
    await page.get_by_test_id("estop").click()
    await expect(page.get_by_test_id("stop-missing")).to_contain_text("Not confirmed: rover-beta")
    await expect(page.get_by_test_id("stop-progress")).to_have_text("5 of 6 robots at rest.")
    await expect(page.locator('[data-robot="rover-beta"]')).not_to_contain_text("stopped")
    await tab.shoot("estop-unreachable")
    await expect(page.get_by_test_id("stop-progress")).to_have_text("All 6 robots are at rest.")
    await expect(page.locator('[data-robot="rover-beta"]')).to_contain_text("stopped, at rest")
    admin = {"authorization": f"Bearer {running.admin}"}
    body = {"type": "execute", "path": "/system/estop", "body": {"reset": True}}
    answer = await robot.post("/rcp/v1/messages", json=body, headers=admin)
    assert answer.json()["status"] == "completed"
    await expect(page.get_by_test_id("estop-active")).to_have_count(0)
