"""Jobs that move robots, and that stop them."""

from __future__ import annotations

import math

from playwright.async_api import expect

from browser.jobs.board import job
from browser.jobs.hands import Fingers, Hands, Keys
from browser.jobs.site import ARM, DRONE, ROVER, Site
from browser.robots import speed

ODOMETRY = f"{ROVER}/sensor/odometry"
METRE = 1e-5  # degrees, about
FLIGHT = 90_000  # ms, where the machine is busy


async def stopped(site: Site, *names: str) -> None:
    """Wait until just these robots are stopped, and at rest; then let them go on."""
    await site.until(
        "/system/estop",
        lambda told: (
            {name: one["state"] for name, one in told["robots"].items()}
            == dict.fromkeys(names, "confirmed")
        ),
    )
    await site.reset()


@job("Stop one robot")
async def stop_one(hands: Hands, site: Site) -> None:
    await hands.press(hands.button("Stop arm"))
    await stopped(site, "arm")


@job("Stop the robots of a tenant")
async def stop_tenant(hands: Hands, site: Site) -> None:
    await hands.press(hands.page.get_by_test_id("stop-menu"))
    await hands.suits()
    menu = hands.page.get_by_role("group", name="What to stop")
    await hands.press(menu.get_by_role("button", name="Stop tenant beta"))
    await stopped(site, "arm")


@job("Stop all robots")
async def stop_all(hands: Hands, site: Site) -> None:
    if isinstance(hands, Keys):
        await hands.page.keyboard.press("F9")
    else:
        await hands.press(hands.page.get_by_test_id("estop"))
    await stopped(site, "arm", "rover", "drone")


@job("Let stopped robots move again")
async def reset(hands: Hands, site: Site) -> None:
    await site.ask("/system/estop", {"scope": "arm"})
    await hands.press(hands.button("Reset arm").first)
    await site.until("/system/estop", lambda told: not told["active"])


@job("Bring a robot to rest without a stop")
async def hold(hands: Hands, site: Site) -> None:
    before = site.arm.halts
    await hands.press(hands.button("Hold arm"))
    await expect(hands.page.get_by_text("arm: at rest.")).to_be_visible()
    assert site.arm.halts > before
    assert not (await site.value("/system/estop"))["active"]


async def take(hands: Hands, robot: str) -> None:
    """Take control of a robot on Teleop."""
    await hands.go("Teleop")
    await hands.choose(hands.page.get_by_role("combobox", name="Robot"), robot)
    await hands.press(hands.button("Take control"))
    await expect(hands.page.get_by_test_id("control")).to_contain_text("You have control")


async def give(hands: Hands, site: Site) -> None:
    """Give control back."""
    await hands.press(hands.button("Release control"))
    await site.until("/system/leases", lambda told: not told)


@job("Take control, drive, and give control back")
async def drive(hands: Hands, site: Site) -> None:
    await take(hands, "rover")

    async def turns() -> None:
        await site.until(ODOMETRY, lambda told: told["twist"]["angular"]["z"] > 0.1)

    if isinstance(hands, Fingers):
        async with hands.slid(hands.page.get_by_test_id("stick").first, -0.25):
            await turns()
    else:
        await hands.page.keyboard.down("Shift")
        await hands.page.keyboard.down("ArrowLeft")
        await turns()
        await hands.page.keyboard.up("ArrowLeft")
        await hands.page.keyboard.up("Shift")
    await site.until(ODOMETRY, lambda told: speed(told) < 0.002)
    await give(hands, site)


@job("Move a joint to a number, and by steps")
async def move_joint(hands: Hands, site: Site) -> None:
    page = hands.page
    await take(hands, "arm")
    await hands.write(page.get_by_label("Target of elbow"), "0.5")
    for name, place in (("Hold to go", 0.5), ("elbow plus", 0.05), ("elbow minus", -0.05)):
        await expect(page.get_by_title("Measured")).to_contain_text("is 0.00")
        async with hands.held(page.get_by_role("button", name=name)):
            await elbow_at(site, place)
        await elbow_at(site, 0.0)  # where it is safe
    await give(hands, site)


async def elbow_at(site: Site, place: float) -> None:
    await site.until(
        f"{ARM}/sensor/elbow", lambda told: math.isclose(told["position"], place, abs_tol=1e-9)
    )


@job("Arm a drone, take off and land")
async def fly(hands: Hands, site: Site) -> None:
    page = hands.page
    await site.ground()
    await take(hands, "drone")
    status, actions = page.get_by_test_id("action-status"), page.get_by_test_id("actions")
    await hands.press(actions.get_by_role("button", name="Mode"))
    await expect(status).to_contain_text("Mode: completed")
    await hands.write(actions.get_by_label("altitude of Take off"), "2")
    async with hands.held(actions.get_by_role("button", name="Arm", exact=True)):
        await expect(status).to_contain_text("Arm: completed")
    async with hands.held(actions.get_by_role("button", name="Take off")):
        await expect(status).to_contain_text("Take off:")
    await expect(status).to_contain_text("Take off: completed", timeout=FLIGHT)
    height = (await site.value(f"{DRONE}/sensor/position/global"))["relative_alt"]
    assert abs(height - 2) < 1, height
    await hands.press(actions.get_by_role("button", name="Land"))
    await expect(status).to_contain_text("Land: completed", timeout=FLIGHT)
    await give(hands, site)


@job("Send a drone to a place on the map")
async def go_to(hands: Hands, site: Site) -> None:
    page = hands.page
    await site.rise()
    before = await site.value(f"{DRONE}/sensor/position/global")
    await hands.go("Map")
    chart = page.get_by_test_id("map")
    await expect(chart).to_have_attribute("data-homes", "1")
    await hands.press(page.get_by_test_id("aim"))
    await hands.point(chart, 1)
    await expect(page.get_by_test_id("goal-status")).to_contain_text("completed")
    after = await site.value(f"{DRONE}/sensor/position/global")
    assert after["lon"] > before["lon"] + METRE, (before, after)


@job("Send a robot to a place in its scene")
async def set_goal(hands: Hands, site: Site) -> None:
    page = hands.page
    before = (await site.value(f"{ROVER}/sensor/pose"))["position"]
    await hands.go("Scene")
    await hands.choose(page.get_by_role("combobox", name="Robot"), "rover")
    await expect(page.get_by_test_id("where")).to_contain_text("in map")
    await hands.press(page.get_by_test_id("aim"))
    await hands.point(page.get_by_test_id("scene").locator("canvas"), 1)
    await expect(page.get_by_test_id("goal-status")).to_contain_text("completed")
    after = (await site.value(f"{ROVER}/sensor/pose"))["position"]
    assert math.hypot(after["x"] - before["x"], after["y"] - before["y"]) > 0.5


async def draw(hands: Hands, what: str, *places: tuple[int, int]) -> None:
    """Begin to draw a mission or a fence with points beside the middle of the map."""
    page = hands.page
    await hands.go("Map")
    await expect(page.get_by_test_id("map")).to_have_attribute("data-homes", "1")
    if await page.get_by_test_id("plan-panel").count() == 0:
        await hands.press(page.get_by_test_id("plan"))
    await hands.press(hands.button(what))
    await expect(page.get_by_test_id("onboard")).to_contain_text("On the vehicle")
    await hands.press(page.get_by_test_id("draw"))
    for right, up in places:
        await hands.point(page.get_by_test_id("map"), right, up)


@job("Draw a mission and upload it")
async def plan_mission(hands: Hands, site: Site) -> None:
    page = hands.page
    await draw(hands, "Mission", (1, 0), (0, 1))
    await hands.press(hands.button("+ Take off"))
    await hands.press(page.get_by_test_id("upload"))
    await expect(page.get_by_test_id("onboard")).to_contain_text("3 items")
    stored = (await site.ask(f"{DRONE}/service/mission/download"))["items"]
    assert [one["command"] for one in stored] == ["NAV_TAKEOFF", "NAV_WAYPOINT", "NAV_WAYPOINT"]
    first, second = stored[1:]
    assert second["latitude"] > first["latitude"] + METRE, stored
    await site.ask(f"{DRONE}/service/mission/clear")


@job("Draw a fence and upload it")
async def plan_fence(hands: Hands, site: Site) -> None:
    page = hands.page
    await draw(hands, "Fence", (1, 1), (0, -1), (-1, 0))
    await hands.press(page.get_by_test_id("upload"))
    await expect(page.get_by_test_id("onboard")).to_contain_text("1 area")
    stored = (await site.ask(f"{DRONE}/service/fence/download"))["items"]
    assert [one["command"] for one in stored] == ["NAV_FENCE_POLYGON_VERTEX_INCLUSION"] * 3
    north, south, west = stored
    assert north["latitude"] > south["latitude"] + METRE, stored
    assert south["longitude"] > west["longitude"] + METRE, stored
    await site.ask(f"{DRONE}/service/fence/upload", {"items": []})
