"""Jobs of whoever looks after robots: finding, watching, deciding."""

from __future__ import annotations

import asyncio
import re

from playwright.async_api import expect

from browser.jobs.board import job
from browser.jobs.hands import Hands, Keys
from browser.jobs.site import ARM, KEYS, Site

FAULT = {"fault": "belt", "message": "the belt slips", "severity": "warning"}


@job("Log in and out")
async def log_in_and_out(hands: Hands, site: Site) -> None:
    page = hands.page
    await hands.press(hands.button("Log out"))
    await hands.press(page.get_by_role("banner").get_by_role("button", name="Log in"))
    dialog = page.get_by_role("dialog")
    await hands.write(dialog.get_by_label("Key or token"), KEYS["ada"])
    await hands.suits()
    await hands.press(dialog.get_by_role("button", name="Log in"))
    await expect(page.get_by_test_id("principal")).to_have_text("ada")


@job("Switch between dark and light")
async def switch_theme(hands: Hands, site: Site) -> None:
    root = hands.page.locator("html")
    before = await root.get_attribute("data-theme")
    switch = hands.page.get_by_role("button", name=re.compile("Switch to"))
    if not await switch.is_visible():  # on a phone it is in a menu
        await hands.press(hands.button("Language and units"))
    await hands.press(switch)
    await expect(root).not_to_have_attribute("data-theme", before or "")
    await hands.press(switch)
    await expect(root).to_have_attribute("data-theme", before or "")


@job("Find the robots that need somebody")
async def find_robot(hands: Hands, site: Site) -> None:
    page = hands.page
    site.arm.host.publish("event/fault", FAULT | {"active": True})
    await hands.go("Fleet")
    await expect(page.locator('tr[data-robot="arm"]')).to_contain_text("alarm")
    await hands.press(page.get_by_role("button", name=re.compile("needs? attention")))
    await expect(page.locator('tr[data-robot="rover"]')).to_have_count(0)
    site.arm.host.publish("event/fault", FAULT | {"active": False})
    await hands.press(hands.button("Show all"))
    await hands.write(page.get_by_label("Search robots"), "rov")
    await expect(page.locator("tr[data-robot]")).to_have_count(1)
    await hands.press(page.get_by_role("link", name="rover", exact=True))
    await expect(page.locator('section[data-robot="rover"]')).to_contain_text("Position")


@job("Look through a robot's camera")
async def look_through_camera(hands: Hands, site: Site) -> None:
    await hands.go("Camera")
    await hands.choose(hands.page.get_by_role("combobox", name="Robot"), "rover")
    camera = hands.page.get_by_test_id("camera")
    await expect(camera).to_have_attribute("data-frames", re.compile(r"\d"))
    await expect(camera).to_have_attribute("data-stale", "false")


@job("Watch a command and cancel it")
async def cancel_command(hands: Hands, site: Site) -> None:
    page = hands.page
    answer = await site.ada.post(f"/rcp/v1/context{ARM}/action/sweep")
    assert answer.status_code == 202, answer.text
    await hands.go("Commands")
    row = page.get_by_role("region", name="Running").locator("tr[data-command]")
    await expect(row).to_contain_text("action/sweep")
    await hands.press(row.locator("button[aria-disabled=false]"))
    await expect(row).to_have_count(0)
    assert await site.arm.stopped.get() == "action/sweep"


@job("Approve what somebody asks for")
async def approve(hands: Hands, site: Site) -> None:
    page = hands.page
    limit = (
        2.25 if isinstance(hands, Keys) else 1.25
    )  # what was approved once is not asked for again
    message = {"type": "write", "path": f"{ARM}/param/limit", "body": limit}
    answer = (await site.clients["lena"].post("/rcp/v1/messages", json=message)).json()
    assert answer["error"]["code"] == "approval_required", answer
    await expect(page.get_by_test_id("badge")).to_contain_text("1")
    await hands.go("Commands")
    asked = page.get_by_role("article", name="lena requests")
    await expect(asked).to_contain_text(str(limit))
    await hands.press(asked.locator("button[aria-disabled=false]", has_text="Approve"))
    await expect(asked).to_have_count(0)
    granted = message | {"approval": answer["error"]["details"]["approval"]}
    answer = (await site.clients["lena"].post("/rcp/v1/messages", json=granted)).json()
    assert site.arm.values["param/limit"] == limit, answer


@job("Acknowledge an alarm")
async def acknowledge(hands: Hands, site: Site) -> None:
    page = hands.page
    site.arm.measure("sensor/battery", 10.0)
    await expect(page.get_by_test_id("alarms")).to_have_count(1)
    await hands.go("Alarms")
    alarm = page.get_by_role("region", name="Not acknowledged").get_by_role("article")
    await hands.write(alarm.get_by_label("Comment"), "on my way")
    await hands.press(alarm.locator("button[aria-disabled=false]"))
    await expect(alarm).to_have_count(0)
    await expect(page.get_by_text("by ada: on my way").first).to_be_visible()
    site.arm.measure("sensor/battery", 90.0)
    await expect(page.get_by_role("region", name="Acknowledged", exact=True)).to_have_count(0)


@job("Plot two values")
async def plot(hands: Hands, site: Site) -> None:
    page = hands.page
    await hands.go("Plot")
    for words in ("battery arm", "sensor elbow arm"):
        await hands.write(page.get_by_label("Path"), words)
        await hands.press(page.locator(".found button").first)
        await hands.press(page.locator(".fields").get_by_role("button").first)
    charts = page.get_by_test_id("chart")
    await expect(charts).to_have_count(2)
    for chart in await charts.all():
        await expect(chart.get_by_test_id("shown")).to_contain_text(re.compile(r"\d"))


@job("Look back at an incident")
async def look_back(hands: Hands, site: Site) -> None:
    page = hands.page
    site.arm.measure("sensor/battery", 80.0)
    await site.ask("/system/estop", {"scope": "arm", "reason": "looked back at"})
    await site.reset()
    await hands.go("Recordings")
    row = page.locator("tr", has_text="emergency stop").first
    await hands.press(row.get_by_role("link", name="Look"))
    await expect(page.get_by_test_id("past")).to_be_visible()
    await hands.press(page.get_by_role("button", name="Back to live"))
    await expect(page.get_by_test_id("past")).to_have_count(0)


@job("Record for a while")
async def record(hands: Hands, site: Site) -> None:
    page = hands.page
    name = f"drive-{type(hands).__name__.lower()}"
    await hands.go("Recordings")
    form = page.get_by_role("form", name="Start a recording")
    await hands.write(form.get_by_label("Name"), name)
    await hands.choose(form.get_by_label("What to record"), "arm")
    await hands.press(form.get_by_role("button", name="Start"))
    row = page.locator("tr", has_text=name)
    await expect(row).to_contain_text("recording")
    site.arm.measure("sensor/battery", 70.0)
    await hands.press(row.get_by_role("button", name="Stop"))
    await expect(row).to_contain_text("kept")


@job("Find an entry of the log")
async def find_entry(hands: Hands, site: Site) -> None:
    page = hands.page
    site.arm.host.publish("event/fault", FAULT | {"message": "the gripper is worn", "active": True})
    site.arm.host.publish("event/fault", FAULT | {"active": False})
    await hands.go("Log")
    await hands.write(page.get_by_label("Filter"), "gripper")
    await expect(page.get_by_text("the gripper is worn").first).to_be_visible()
    await expect(page.get_by_text("the belt slips")).to_have_count(0)


@job("End somebody's session")
async def end_session(hands: Hands, site: Site) -> None:
    page = hands.page
    await hands.go("People")
    sessions = page.get_by_role("region", name="Sessions")
    async with asyncio.timeout(60), site.session("otto") as session:
        row = sessions.locator("tr").filter(has=page.get_by_text("otto", exact=True))
        await hands.press(row.get_by_role("button", name="End the session"))
        await hands.suits()
        await hands.press(page.get_by_role("dialog").get_by_role("button", name="End session"))
        await expect(row).to_have_count(0)
        await session.wait_closed()


@job("Revoke a key")
async def revoke_key(hands: Hands, site: Site) -> None:
    page = hands.page
    token, _ = site.tokens.create(f"ann-{type(hands).__name__}", (("alpha", ("operator",)),), None)
    await hands.go("People")
    row = page.get_by_role("region", name="Keys").locator(f'[data-key="{token.id}"]')
    await hands.press(row.get_by_role("button", name="Revoke the key"))
    await hands.press(page.get_by_role("dialog").get_by_role("button", name="Revoke key"))
    await expect(row).to_contain_text("revoked")
