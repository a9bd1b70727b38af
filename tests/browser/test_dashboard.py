"""The dashboard in a real browser, beside the real demo."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from urllib.parse import urlencode

import httpx
import pytest
from playwright.async_api import Browser, expect

from browser.proxy import below
from browser.watched import Watched, log_in, watched
from certs import Authority
from configuration import backend, key, listener, table, tls
from docs.demo import Demo, demo
from rcp_gateway.log import configure
from rcp_gateway.testing import serve
from rcp_kernel.config.file import parse

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
PAGES = (
    "",
    "fleet",
    "explore",
    "parameters",
    "teleop",
    "camera",
    "scene",
    "map",
    "plot",
    "commands",
    "log",
    "people",
)
SHOWN = {
    "explore": "path=/tenant/alpha/sensor/pose",
    "plot": urlencode(
        [
            ("p", "/tenant/alpha/sensor/imu#linear_acceleration.x"),
            ("p", "/tenant/alpha/sensor/imu#linear_acceleration.z"),
            ("p", "/tenant/beta/sensor/imu#angular_velocity.z"),
            ("p", "/tenant/alpha/sensor/battery#voltage,/tenant/beta/sensor/battery#voltage"),
            ("span", "10"),
        ]
    ),
}
"""What the pages show that show nothing by themselves."""
SEEN = {
    "": "rover-alpha",
    "fleet": "rover-alpha",
    "explore": "orientation",
    "parameters": "speed_limit",
    "teleop": "Take control",
    "camera": " Hz",
    "scene": "sensor/map",
    "map": "drone-gamma",
    "plot": "linear_acceleration.x",
    "commands": "action/move_to",
    "log": "boot",
    "people": "this page",
}
"""What of its own each page has to show."""
POSING = {"plot": 10_000, "scene": 5000, "camera": 3000} if "RCP_SCREENSHOTS" in os.environ else {}
"""ms until a page has something to show to those who look at the screenshots."""
ROBOTS = (
    backend("rover", use="sim")
    + backend("rover-beta", "beta", use="sim")
    + key("looks-at-beta", "a-key-that-may-only-look", role="viewer", tenants=["beta"])
)


@pytest.fixture
async def tab(browser: Browser, running: Demo) -> AsyncGenerator[Watched]:
    """Open the demo's dashboard, watched."""
    async with watched(browser, running.url) as found:
        await found.open()
        await found.connected()
        yield found


@asynccontextmanager
async def gateway(asgi: str = "", more: str = "") -> AsyncGenerator[str]:
    """Run a gateway with two rovers in this process; yield its address."""
    configure("error", "json")
    text = listener() + asgi + table("plugins.dashboard") + ROBOTS + more
    async with serve(parse(text, "test")) as served:
        yield next(facts["url"] for facts in served.server.status.transports if "url" in facts)


async def test_every_page_opens_and_nothing_is_complained_of(tab: Watched, running: Demo) -> None:
    await log_in(tab.page, running.key)
    await expect(tab.page.get_by_text("rover-alpha").first).to_be_visible()
    headers = {"authorization": f"Bearer {running.key}"}
    goal = {"position": {"x": 4.0, "y": 3.0, "z": 0.0}}
    async with httpx.AsyncClient(base_url=running.url, headers=headers) as robot:
        path = "/rcp/v1/context/tenant/alpha/action/move_to"
        assert (await robot.post(path, json=goal)).status_code == 202  # pages show that it moves
    for name in PAGES:
        await tab.open(f"{name}?{SHOWN.get(name, 'robot=rover-alpha')}")
        await expect(tab.page.locator("main")).not_to_contain_text("Loading")
        await expect(tab.page.locator("main")).not_to_contain_text("did not come")
        await expect(tab.page.locator("main")).to_contain_text(SEEN[name])
        await tab.page.wait_for_load_state("networkidle")
        await tab.page.wait_for_timeout(POSING.get(name, 0))
        await tab.shoot(f"page-{name or 'overview'}")


async def test_light_and_small_look_right_too(browser: Browser, running: Demo) -> None:
    tablet = {"width": 820, "height": 1180}
    async with watched(browser, running.url, color_scheme="light", has_touch=True) as tab:
        await tab.page.set_viewport_size(tablet)
        for name in ("", "explore", "teleop"):
            await tab.open(name)
            await tab.connected()
            await tab.shoot(f"tablet-light-{name or 'overview'}")
            wide = await tab.page.evaluate("document.documentElement.scrollWidth")
            assert wide <= tablet["width"], f"{name} has to be scrolled sideways"


async def test_below_a_prefix_it_works_the_same(browser: Browser) -> None:
    async with (
        gateway() as url,
        below("/site/robots", int(url.rpartition(":")[2])) as shown,
        watched(browser, shown) as tab,
    ):
        await tab.open()
        await tab.connected()
        await expect(tab.page.get_by_text("rover").first).to_be_visible()
        for name in PAGES:
            await tab.open(name)
            await expect(tab.page.locator("main")).not_to_contain_text("did not come")


async def test_where_the_gateway_knows_of_the_prefix_it_works_too(browser: Browser) -> None:
    async with gateway(asgi='root_path = "/robots"') as url, watched(browser, url) as tab:
        await tab.page.goto(url)  # without the slash
        await tab.connected()
        assert tab.page.url.startswith(f"{url}/")


async def test_over_tls_it_works_the_same(browser: Browser, tmp_path: Path) -> None:
    server = Authority(tmp_path).server()
    async with (
        gateway(asgi=tls(server)) as url,
        watched(browser, url, ignore_https_errors=True) as tab,
    ):
        assert url.startswith("https://")
        await tab.open()
        await tab.connected()
        await expect(tab.page.get_by_text("rover").first).to_be_visible()


async def test_who_is_refused_is_told_and_may_log_in(browser: Browser) -> None:
    closed = "[anonymous]\nrole = []\n"
    async with gateway(more=closed) as url, watched(browser, url) as tab:
        await tab.open()
        await expect(tab.page.get_by_role("heading", name="Log in required")).to_be_visible()
        await log_in(tab.page, "a-key-that-may-only-look")
        await tab.connected()
        await expect(tab.page.get_by_test_id("principal")).to_have_text("looks-at-beta")


async def test_a_limited_role_sees_its_tenant_and_is_offered_no_more(browser: Browser) -> None:
    async with gateway() as url, watched(browser, url) as tab:
        await tab.open()
        await tab.connected()
        await log_in(tab.page, "a-key-that-may-only-look")
        await expect(tab.page.get_by_test_id("principal")).to_have_text("looks-at-beta")
        await expect(tab.page.get_by_test_id("roles")).to_have_text("viewer")
        await expect(tab.page.get_by_text("rover-beta").first).to_be_visible()
        await tab.open("explore")
        tree = tab.page.get_by_role("region", name="Resources")
        await expect(tree).to_contain_text("beta / rover-beta")
        await expect(tree).not_to_contain_text("alpha")
        await tab.shoot("limited-role")
        kept = await tab.page.evaluate("document.cookie + location.href")
        assert "a-key-that-may-only-look" not in kept


async def test_a_page_whose_gateway_is_killed_comes_back_with_it(
    browser: Browser, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with demo(tmp_path, port) as first:
        async with watched(browser, first.url) as tab:
            tab.expected += [
                r"WebSocket connection.*failed",
                r"ERR_CONNECTION",
                "ERR_EMPTY",
                "ERR_NETWORK",
            ]
            await tab.open()
            card = tab.page.locator('[data-robot="rover-alpha"]')
            await expect(card).to_contain_text("ready")
            first.process.kill()
            await expect(tab.page.locator('[data-state="waiting"]')).to_be_visible()
            await expect(tab.page.get_by_test_id("gone")).to_contain_text("No connection")
            await expect(card).to_contain_text("unknown")
            await tab.shoot("gateway-gone")
            with demo(tmp_path, port):
                await tab.connected()
                await expect(tab.page.get_by_text("rover-alpha").first).to_be_visible()
                up = tab.page.get_by_text(re.compile(r"^Uptime$")).locator(
                    "xpath=following-sibling::*"
                )
                await expect(up).to_have_text(re.compile(r"^\d+ ?s$|^\d+:\d\d$"))


async def test_before_it_is_connected_the_overview_claims_nothing(
    browser: Browser, running: Demo
) -> None:
    async with watched(browser, running.url) as tab:
        await tab.page.route_web_socket("**/ws*", lambda _: None)  # which is never answered
        await tab.open("")
        await expect(tab.page.get_by_role("region", name="Warnings")).to_contain_text("Loading")
        await expect(tab.page.get_by_text("None since")).to_have_count(0)
