"""Numbers that are typed: what a robot gets is what stands in the box, in any language, and what is unsure is not sent."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from typing import Any

import msgspec
import pytest
from playwright.async_api import Browser, Locator, expect

from browser.watched import Watched, watched
from browser.worlds import KEY, Teller, World, world
from rcp_kernel.model import Resource
from rcp_kernel.types import quantity

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
ROBOT = "/tenant/alpha"
UP = "action/takeoff"
_HOME = {"latitude": 47.0, "longitude": 8.0}


class Fix(msgspec.Struct):
    latitude: float
    longitude: float


class Height(msgspec.Struct):
    """How high to go; without a height, as high as is usual."""

    altitude: quantity("m") | None = 10.0  # pyright: ignore[reportInvalidTypeForm]


class Plan(msgspec.Struct):
    items: list[Any]


class Gains(msgspec.Struct, kw_only=True):
    gain: float
    offset: float


_RESOURCES = [
    Resource(name="sensor/gps", description="Where it is.", value=Fix, live=True),
    Resource(name="sensor/elbow", description="Where it is.", value=quantity("rad"), live=True),
    Resource(name="actuator/elbow", description="The elbow.", value=quantity("rad", ge=-2, le=20)),
    Resource(name=UP, description="Take off.", input=Height),
    Resource(name="action/mission/upload", description="Take a mission.", input=Plan),
    Resource(name="service/mission/download", description="Tell it.", output=Plan),
    Resource(name="service/fence/download", description="Tell it.", output=Plan),
    Resource(name="action/fence/upload", description="Take a fence.", input=Plan),
    Resource(name="service/tune", description="Take gains.", input=Gains, output=Gains),
]


async def _same(value: Any, progress: Any) -> Any:
    return value


@pytest.fixture(scope="module")
async def gateway() -> AsyncGenerator[World]:
    async with world({"copter": ("alpha", _RESOURCES)}) as made:
        robot = made.robots["copter"]
        plans: dict[str, Any] = {"mission": Plan([]), "fence": Plan([])}
        for what in ("mission", "fence"):

            async def upload(value: Any, progress: Any, what: str = what) -> None:
                plans[what] = value

            async def download(value: Any, progress: Any, what: str = what) -> Any:
                return plans[what]

            robot.behaviours[f"action/{what}/upload"] = upload
            robot.behaviours[f"service/{what}/download"] = download
        robot.behaviours["service/tune"] = robot.behaviours[UP] = _same
        made.publish("copter", "sensor/gps", _HOME)
        made.publish("copter", "sensor/elbow", 0.0)
        yield made


@pytest.fixture(scope="module")
async def german(browser: Browser, gateway: World) -> AsyncGenerator[Watched]:
    """Sit at a browser whose page is in German, but whose own language is not."""
    async with watched(browser, gateway.url) as tab:
        await tab.page.add_init_script("localStorage.setItem('rcp.language', 'de')")
        await tab.open()
        await tab.connected()
        await tab.page.get_by_role("button", name="Anmelden").first.click()
        dialog = tab.page.get_by_role("dialog")
        await dialog.get_by_label("Schlüssel oder Token").fill(KEY)
        await dialog.get_by_role("button", name="Anmelden").click()
        await dialog.wait_for(state="detached")
        yield tab


@pytest.fixture
def robot(gateway: World) -> Teller:
    found = gateway.robots["copter"]
    found.ran.clear()
    found.writes.clear()
    return found


async def enter(box: Locator, text: str) -> None:
    """Type into a box, in place of what is there, key by key."""
    await box.click()
    await box.press("ControlOrMeta+a")
    await box.press_sequentially(text)


async def planning(tab: Watched) -> None:
    """Open the plan of the copter, on a map that begins anew."""
    await tab.open("log")
    await tab.open("map")
    await tab.page.get_by_test_id("plan").click()
    await expect(tab.page.get_by_test_id("onboard")).to_contain_text("Im Fahrzeug")


async def test_a_height_with_a_comma_is_that_height(german: Watched, robot: Teller) -> None:
    page = german.page
    await german.open("teleop?robot=copter")
    actions = page.get_by_test_id("actions")
    box = actions.get_by_role("textbox")
    button = actions.get_by_role("button")
    await expect(box).to_have_value("10")
    for unsure in ("1,5,5", "1.500", " ", "x"):
        await enter(box, unsure)
        await expect(button).to_be_disabled()
        await expect(box).to_have_attribute("aria-invalid", "true")
    await enter(box, "1,5")
    await button.hover()
    await page.mouse.down()
    await expect(page.get_by_test_id("action-status")).to_contain_text("abgeschlossen")
    await page.mouse.up()
    assert [value.altitude for _, value in robot.ran] == [1.5]


async def test_a_mission_and_a_fence_get_what_was_typed(german: Watched, robot: Teller) -> None:
    page = german.page
    await planning(german)
    await enter(page.get_by_label("Höhe neuer Wegpunkte"), "12,5")
    await page.get_by_role("button", name="+ Wegpunkt").click()
    altitude = page.get_by_label("Höhe von Eintrag 1")
    await expect(altitude).to_have_value("12,5")
    await enter(altitude, "1,5")
    await enter(page.get_by_label("Breitengrad von Eintrag 1"), "47,0005")
    await page.get_by_test_id("upload").click()
    await expect(page.get_by_test_id("goal-status")).to_contain_text("abgeschlossen")
    (item,) = next(value for name, value in robot.ran if name == "action/mission/upload").items
    assert (item["altitude"], item["latitude"]) == (1.5, 47.0005)
    await expect(altitude).to_have_value("1,5")


async def test_a_place_of_a_fence_that_is_no_number_is_not_shown_as_if_it_were_kept(
    german: Watched, robot: Teller
) -> None:
    page = german.page
    await planning(german)
    await page.get_by_role("button", name="Geofence", exact=True).click()
    await page.get_by_role("button", name="+ Kreis").click()
    radius = page.get_by_label("Radius von Bereich 1")
    await enter(radius, "99,5")
    latitude = page.get_by_label("Breitengrad von Ecke 1 des Bereichs 1")
    before = await latitude.input_value()
    await enter(latitude, "4.7.0")
    await latitude.press("Tab")
    await expect(latitude).to_have_value(before)
    await page.get_by_test_id("upload").click()
    await expect(page.get_by_test_id("goal-status")).to_contain_text("abgeschlossen")
    (item,) = next(value for name, value in robot.ran if name == "action/fence/upload").items
    assert item["params"][0] == 99.5
    await enter(radius, "viel")
    await radius.press("Tab")
    await expect(page.get_by_test_id("upload")).to_be_disabled()


async def test_a_form_keeps_what_is_typed_as_it_is_typed(german: Watched, robot: Teller) -> None:
    page = german.page
    await german.open(f"explore?path={ROBOT}/service/tune")
    form = page.get_by_test_id("ask-execute")
    gain, offset = form.get_by_label("gain"), form.get_by_label("offset")
    await enter(gain, "0,05")
    await gain.press("Backspace")
    await expect(gain).to_have_value("0,0")
    await gain.press_sequentially("7")
    await enter(offset, "12.5")
    await offset.press("Backspace")
    await offset.press_sequentially("7")
    await expect(gain).to_have_value("0,07")
    run = form.get_by_role("button", name="Ausführen", exact=True)
    for unsure in ("1.500", "0x10"):
        await enter(gain, unsure)
        await run.click()
        await expect(form.locator('[data-pointer="/gain"]').get_by_role("alert")).to_be_visible()
        await expect(gain).to_have_attribute("aria-invalid", "true")
        await expect(gain).to_have_value(unsure)
    await enter(gain, "0,07")
    await expect(gain).to_have_attribute("aria-invalid", "false")
    await run.click()
    await expect(form.get_by_test_id("answer")).to_be_visible()
    ((_, sent),) = robot.ran
    assert (sent.gain, sent.offset) == (0.07, 12.7)


async def test_a_joint_goes_where_a_comma_says(german: Watched, robot: Teller) -> None:
    page = german.page
    await german.open("teleop?robot=copter")
    await page.get_by_role("button", name="Steuerung übernehmen").first.click()
    target = page.get_by_label("Sollwert")
    go = page.get_by_role("button", name="Los", exact=True)
    await enter(target, "1.500")
    await expect(go).to_be_disabled()
    await enter(target, "-1,5")
    await go.click()
    async with asyncio.timeout(60):
        while not robot.writes:  # noqa: ASYNC110 - the robot tells nobody
            await asyncio.sleep(0.02)
    assert robot.writes == [("actuator/elbow", -1.5)]


async def test_other_units_begin_with_what_was_not_typed_in_the_units_before(
    german: Watched, robot: Teller
) -> None:
    page = german.page
    await german.open("teleop?robot=copter")
    actions = page.get_by_test_id("actions")
    box = actions.get_by_role("textbox")
    await enter(box, "30")
    await page.get_by_test_id("preferences").click()
    await page.get_by_role("combobox", name="Einheiten").select_option("imperial")
    await expect(box).to_have_value("32,81")
    await enter(box, "100")
    await actions.get_by_role("button").hover()
    await page.mouse.down()
    await expect(page.get_by_test_id("action-status")).to_contain_text("abgeschlossen")
    await page.mouse.up()
    assert [value.altitude for _, value in robot.ran] == [30.48]
