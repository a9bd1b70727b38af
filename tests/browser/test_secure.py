from __future__ import annotations

from pathlib import Path

import pytest
from playwright.async_api import Browser

from browser.elsewhere import ATTEMPTS
from certs import Authority
from configuration import tls
from transports.robot import site

pytestmark = pytest.mark.anyio
ANYBODY = '[anonymous]\nrole = "operator"\n'  # nothing but the origin keeps a page out


async def test_pages_over_tls_are_told_apart_by_their_scheme_too(
    browser: Browser, tmp_path: Path
) -> None:
    server = Authority(tmp_path).server()
    context = await browser.new_context(ignore_https_errors=True)  # it does not know the CA
    page = await context.new_page()
    async with site(asgi=tls(server), more=ANYBODY) as gateway, site(more=ANYBODY) as plain:
        gateway.robot.release.set()
        urls = [gateway.url, gateway.ws.replace("ws:", "wss:")]
        await page.goto(gateway.url)
        own = await page.evaluate(ATTEMPTS, urls)
        for attempt in ("get", "put", "execute", "events", "websocket", "websocket of json"):
            assert own[attempt].startswith("read: "), (attempt, own[attempt])
        gateway.server.gateway.counts.outcomes.clear()
        await page.goto(plain.url)
        found = await page.evaluate(ATTEMPTS, urls)
        assert set(found.values()) <= {"blocked", "opaque"}
        asked = {
            code
            for _, type_, code in gateway.server.gateway.counts.outcomes
            if type_ != "connection"
        }
        assert asked == {"forbidden"}
    await context.close()
