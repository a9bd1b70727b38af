"""The parameters of a simulated copter, as its operator edits them: found, compared, written together and read back."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.async_api import Browser, FilePayload, Locator, Page, expect

import rcp_mavlink
from browser.accessible import SMALL, WIDER, violations
from browser.machines import key_of
from browser.robots import until, value
from browser.watched import Watched, signed_in
from browser.worlds import Silent, line
from configuration import backend, key, listener, role, rule, table
from rcp_kernel.config.file import parse
from rcp_kernel.testing import serve

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
PARAM = "/tenant/alpha/param"
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
ABOUT = """<paramfile><vehicles><parameters name="ArduCopter">
<param humanName="Return height" name="ArduCopter:RTL_ALT" documentation="Height above home of the return flight">
<field name="Range">200 8000</field><field name="Units">cm</field></param>
<param humanName="Enable" name="FENCE_ENABLE" documentation="Whether the fence is enabled">
<values><value code="0">Disabled</value><value code="1">Enabled</value></values></param>
<param humanName="Types" name="FENCE_TYPE" documentation="Which fences are enabled">
<field name="Bitmask">0:Height,1:Circle,2:Polygon</field></param>
<param humanName="Frame" name="FRAME_CLASS" documentation="Kind of frame">
<field name="RebootRequired">True</field></param>
</parameters></vehicles></paramfile>"""
TEN = {f"RC{n}_DZ": 10 + n for n in range(1, 11)}
"""Ten changes that stand beside each other."""


@pytest.fixture(scope="module")
async def url(tmp_path_factory: pytest.TempPathFactory) -> AsyncGenerator[str]:
    """Serve a copter with all its parameters, some of them described."""
    about = tmp_path_factory.mktemp("about") / "apm.pdef.xml"
    about.write_text(ABOUT)
    text = (
        listener()
        + table("plugins.dashboard")
        + backend("drone", use="mavlink", links=["sim:copter"], parameters=str(about))
        + table("backends.twin", warmup=0.5, noise=0)
        + key("otto", key_of("otto"), role="operator")
        + key("gil", key_of("gil"), role="viewer")
        + key("lena", key_of("lena"), role="most")
        + role("most", rule("*", "/**"), approve=[f"{PARAM}/RC5_DZ"])
    )
    async with serve(parse(text, "test"), *rcp_mavlink.rcp_backends()) as served:
        yield next(f["url"] for f in served.server.status.transports if "url" in f)


async def test_look(browser: Browser, url: str) -> None:
    async with signed_in(browser, url, key_of("otto"), "otto") as tab:
        await tab.open("parameters")
        await expect(tab.page.get_by_test_id("parameter-count")).to_contain_text(re.compile(r"\d{3}"))
        await expect(tab.page.get_by_label("Value of ACRO_BAL_PITCH")).to_have_value("1")
        await tab.page.get_by_label("Search parameters").fill("fence")
        await tab.page.get_by_label("Value of FENCE_TYPE").fill("400")
        await tab.page.get_by_label("Value of FENCE_ENABLE").fill("1")
        await tab.shoot("params-1")
        await tab.page.set_viewport_size({"width": 390, "height": 844})
        await tab.shoot("params-phone")
