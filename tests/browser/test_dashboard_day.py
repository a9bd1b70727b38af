"""The dashboard left open all day: machines sleep, networks swallow, gateways come back as others."""

from __future__ import annotations

import asyncio
import gzip
import re
import shutil
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import msgspec
import pytest
from playwright.async_api import Browser, expect

import rcp_dashboard.pages
from browser.robots import until
from browser.watched import Watched, log_in, require_pages, watched
from browser.worlds import KEY, OTHER, SPARE, World, line, live, world
from ports import free_port
from rcp_dashboard.pages import STATIC

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
ROVER = [live("sensor/pose"), live("sensor/battery"), live("sensor/mode"), live("event/fault")]
LOST = [r"WebSocket", r"ERR_", r"Failed to load resource"]


@asynccontextmanager
async def seat(
    browser: Browser, url: str, key: str = KEY, **options: Any
) -> AsyncGenerator[Watched]:
    """Open the dashboard and log in."""
    async with watched(browser, url, **options) as tab:
        tab.expected += LOST
        await tab.open()
        await log_in(tab.page, key)
        await tab.connected()
        yield tab


async def test_a_machine_that_wakes_tells_what_is_old_and_goes_on_by_itself(
    browser: Browser,
) -> None:
    async with (
        world({"rover": ("alpha", ROVER)}) as gateway,
        line(gateway.url) as way,
        watched(browser, way.url) as tab,
    ):
        tab.expected += LOST
        await tab.page.clock.install()
        await tab.open()
        await log_in(tab.page, KEY)
        await tab.connected()
        gateway.publish("rover", "sensor/mode", "AUTO")
        card = tab.page.locator('[data-robot="rover"]')
        await expect(card).to_contain_text("AUTO")
        before = await subscriptions(gateway)
        way.mute()
        trying = asyncio.ensure_future(way.another())
        await asyncio.sleep(0)
        await tab.page.clock.fast_forward("03:00:00")
        await expect(tab.page.get_by_test_id("gone")).to_be_visible()
        await expect(card).to_contain_text("Last known state")
        await trying  # and nobody answers
        opened = way.opened
        way.speak()
        await tab.page.clock.fast_forward("00:12")
        await tab.connected()
        await expect(card).not_to_contain_text("Last known state")
        await expect(tab.page.get_by_test_id("principal")).to_have_text("wall")
        gateway.publish("rover", "sensor/mode", "HOLD")
        await expect(card).to_contain_text("HOLD")
        assert await subscriptions(gateway) == before  # one session, and nothing twice
        assert way.opened - opened < 6, "tries of a page that has its connection"


async def subscriptions(gateway: World) -> Any:
    async with httpx.AsyncClient(
        base_url=gateway.url, headers={"authorization": f"Bearer {KEY}"}
    ) as client:
        got = (await client.get("/rcp/v1/context/system/status")).json()["body"]
        return got["sessions"], got["subscriptions"]


async def test_a_stop_gets_there_although_the_connection_is_dead_and_nobody_knows(
    browser: Browser,
) -> None:
    async with (
        world({"rover": ("alpha", ROVER)}) as gateway,
        line(gateway.url) as way,
        seat(browser, way.url) as tab,
    ):
        way.mute()
        way.speak()  # what is opened from now on passes
        await tab.page.keyboard.press("F9")
        async with httpx.AsyncClient(base_url=gateway.url, headers=bearer(KEY)) as client:
            await until(client, "/system/estop", lambda told: told["active"])
        await expect(tab.page.get_by_test_id("estop-active")).to_be_visible()
        await expect(tab.page.get_by_text("Emergency stop: ", exact=True)).to_have_count(0)


async def test_nothing_of_a_gateway_that_is_another_one_now_stays_on_the_screen(
    browser: Browser,
) -> None:
    port = free_port()
    old = {"rover": ("alpha", ROVER), "crane": ("beta", ROVER)}
    new = {"rover": ("alpha", ROVER), "mower": ("delta", ROVER)}
    async with world(old, port) as gateway:
        opening = seat(browser, gateway.url)
        tab = await opening.__aenter__()
        gateway.publish("rover", "sensor/mode", "OLD-MODE")
        cards = tab.page.locator("[data-robot]")
        await expect(cards).to_have_count(2)
        await expect(tab.page.locator('[data-robot="rover"]')).to_contain_text("OLD-MODE")
        async with httpx.AsyncClient(base_url=gateway.url, headers=bearer(KEY)) as client:
            body = {"do": "acquire", "scope": "/tenant/alpha", "ttl": 60}
            await client.post("/rcp/v1/context/system/leases", json=body)
    try:
        await expect(tab.page.get_by_test_id("gone")).to_be_visible()
        async with world(new, port, role="viewer") as gateway:
            async with httpx.AsyncClient(base_url=gateway.url, headers=bearer(OTHER)) as client:
                stop = {"type": "execute", "path": "/system/estop", "body": {"reason": "a fire"}}
                (await client.post("/rcp/v1/messages", json=stop)).raise_for_status()
            await tab.connected()
            await expect(tab.page.get_by_test_id("roles")).to_have_text("viewer")
            await expect(tab.page.locator('[data-robot="mower"]')).to_be_visible()
            await expect(tab.page.locator('[data-robot="crane"]')).to_have_count(0)
            await expect(tab.page.get_by_text("OLD-MODE")).to_have_count(0)
            await expect(tab.page.get_by_test_id("estop-active")).to_contain_text("a fire")
            await expect(tab.page.get_by_test_id("estop-reset")).to_have_count(0)
            await tab.shoot("day-another-gateway")
        tab.check()
    finally:
        await opening.__aexit__(None, None, None)


async def test_what_comes_later_than_its_gateway_is_followed_when_it_comes(
    browser: Browser,
) -> None:
    port = free_port()
    path = "/tenant/alpha/sensor/level"
    level = [live("sensor/level")]
    async with world({"tank": ("alpha", level)}, port) as gateway:
        opening = seat(browser, gateway.url)
        tab = await opening.__aenter__()
        await tab.open(f"plot?p={path}%23")
        gateway.publish("tank", "sensor/level", 1.25)
        await expect(tab.page.get_by_test_id("shown")).to_contain_text("1.2500")
    try:
        await expect(tab.page.get_by_test_id("gone")).to_be_visible()
        async with world({"tank": ("alpha", [])}, port) as gateway:
            await tab.connected()
            await expect(tab.page.get_by_test_id("chart")).to_contain_text("not available")
            gateway.robots["tank"].host.declare(*level)
            await expect(tab.page.get_by_test_id("chart")).not_to_contain_text("not available")
            gateway.publish("tank", "sensor/level", 7.5)
            await expect(tab.page.get_by_test_id("shown")).to_contain_text("7.5000")
    finally:
        await opening.__aexit__(None, None, None)


async def test_who_loses_a_right_or_the_key_while_looking_is_told_and_logs_in_in_place(
    browser: Browser,
) -> None:
    async with (
        world({"rover": ("alpha", ROVER)}, spare=True) as gateway,
        seat(browser, gateway.url, SPARE) as tab,
    ):
        await tab.open("explore?path=/tenant/alpha/sensor/mode")
        gateway.publish("rover", "sensor/mode", "AUTO")
        await expect(tab.page.get_by_test_id("value")).to_contain_text("AUTO")
        await rekey(gateway, spare="viewer")
        await expect(tab.page.get_by_test_id("roles")).to_have_text("viewer")
        await rekey(gateway, spare=None)
        await expect(tab.page.get_by_role("heading", name="Log in required")).to_be_visible()
        await expect(tab.page.locator("main")).to_contain_text("no longer valid")
        await expect(tab.page.get_by_text("AUTO")).to_have_count(0)
        await tab.shoot("day-key-gone")
        await log_in(tab.page, KEY)
        await expect(tab.page.get_by_test_id("principal")).to_have_text("wall")
        await expect(tab.page.get_by_test_id("value")).to_contain_text("AUTO")


async def rekey(gateway: World, spare: str | None) -> None:
    """Read another configuration, as at a SIGHUP, in which the spare key has another role or is gone."""
    server = gateway.served.server
    config = server.gateway.settings.config
    keys = [
        msgspec.structs.replace(key, role=spare) if key.name == "spare" else key
        for key in config.keys
        if key.name != "spare" or spare is not None
    ]
    server.gateway.reconfigure(msgspec.structs.replace(config, keys=tuple(keys)))


async def test_a_page_of_another_version_of_the_gateway_says_so_and_is_never_blank(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = free_port()
    require_pages()
    other = tmp_path / "static"
    shutil.copytree(STATIC, other)
    for packed in other.rglob("*.gz"):
        packed.with_suffix("").write_bytes(gzip.decompress(packed.read_bytes()))
        packed.unlink()
    index = other / "index.html"
    # A chunk's name is a hash of what it holds, the names that it imports included: all are others.
    chunks = sorted((other / "assets").glob("*.js"))
    for place in (index, *chunks):
        text = place.read_text()
        for chunk in chunks:
            text = text.replace(chunk.name, f"{chunk.stem}-other.js")
        place.write_text(text)
    for chunk in chunks:
        chunk.rename(chunk.with_name(f"{chunk.stem}-other.js"))
    async with world({"rover": ("alpha", ROVER)}, port) as gateway:
        opening = seat(browser, gateway.url)
        tab = await opening.__aenter__()
        await expect(tab.page.get_by_test_id("outdated")).to_have_count(0)
        # Loaded before: of a page that is not, every name would be another one there.
        await tab.open("explore")
        await expect(tab.page.get_by_role("searchbox", name="Search")).to_have_count(1)
    try:
        await expect(tab.page.get_by_test_id("gone")).to_be_visible()
        monkeypatch.setattr(rcp_dashboard.pages, "STATIC", other)
        async with world({"rover": ("alpha", ROVER)}, port):
            await tab.connected()
            await expect(tab.page.get_by_test_id("outdated")).to_be_visible()
            await tab.open("scene")
            await expect(tab.page.locator("main")).to_contain_text("could not be loaded")
            await tab.shoot("day-other-version")
            await tab.open("explore")
            await expect(tab.page.get_by_role("searchbox", name="Search")).to_have_count(1)
            await tab.page.get_by_role("button", name="Reload").click()
            await tab.connected()
            await expect(tab.page.get_by_test_id("principal")).to_have_text("wall")
            await expect(tab.page.get_by_test_id("outdated")).to_have_count(0)
    finally:
        await opening.__aexit__(None, None, None)


FULL = """
const full = () => { throw new DOMException("no room", "QuotaExceededError"); };
Storage.prototype.setItem = full;
"""
BLOCKED = """
for (const name of ["localStorage", "sessionStorage"])
  Object.defineProperty(window, name, { get() { throw new DOMException("denied", "SecurityError"); } });
"""
GARBAGE = """
for (const store of [localStorage, sessionStorage])
  if (!store.getItem("begun")) {
    for (const key of ["rcp.theme", "rcp.token", "rcp.layout", "plots"]) store.setItem(key, "{\\u0000[\\u202e💥");
    store.setItem("begun", "1");
  }
"""


@pytest.mark.parametrize("script", [FULL, BLOCKED, GARBAGE], ids=["full", "blocked", "garbage"])
async def test_a_browser_that_keeps_nothing_or_nonsense_is_good_enough(
    browser: Browser, script: str
) -> None:
    async with world({"rover": ("alpha", ROVER)}) as gateway, watched(browser, gateway.url) as tab:
        tab.expected += LOST
        await tab.page.add_init_script(script)
        await tab.open()
        await log_in(tab.page, KEY)
        await tab.connected()
        await expect(tab.page.get_by_test_id("principal")).to_have_text("wall")
        await tab.page.get_by_role("button", name=re.compile("Switch to")).click()
        await tab.open("explore")
        await expect(tab.page.locator('[data-path="/tenant/alpha/sensor/mode"]')).to_be_visible()


def bearer(key: str) -> dict[str, str]:
    return {"authorization": f"Bearer {key}"}
