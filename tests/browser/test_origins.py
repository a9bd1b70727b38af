from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from playwright.async_api import Browser, Page

from browser.elsewhere import ATTEMPTS, PAGE, elsewhere
from transports.robot import Site, site

pytestmark = pytest.mark.anyio
ANYBODY = '[anonymous]\nrole = "operator"\n'  # nothing but the origin keeps a page out


@asynccontextmanager
async def open_to_anybody(asgi: str = "") -> AsyncGenerator[Site]:
    async with site(asgi=asgi, more=ANYBODY) as gateway:
        yield gateway


async def attempts(page: Page, gateway: Site, host: str = "127.0.0.1") -> dict[str, str]:
    netloc = f"{host}:{gateway.port}"
    return await page.evaluate(ATTEMPTS, [f"http://{netloc}", f"ws://{netloc}/rcp/v1/ws"])


def untouched(gateway: Site) -> bool:
    """Tell whether no command ran, nothing was written, and nobody has a session."""
    kernel = gateway.server.gateway
    asked = {type_ for _, type_, code in kernel.counts.outcomes if code == "ok"}
    return (
        not list(kernel.commands.every())
        and gateway.robot.started.empty()
        and not kernel.sessions.known
        and not asked & {"write", "execute", "read", "subscribe", "hello"}
    )


def kept_out(found: dict[str, str], gateway: Site) -> None:
    wrong = {name: told for name, told in found.items() if told not in ("blocked", "opaque")}
    assert not wrong
    assert len(found) > 25
    refused = sum(
        n
        for (_, _, code), n in gateway.server.gateway.counts.outcomes.items()
        if code == "forbidden"
    )
    assert refused > 20, "the attempts have not come as far as the gateway"
    assert untouched(gateway)


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
@pytest.mark.parametrize("asked", ["127.0.0.1", "localhost"])
async def test_a_page_of_another_port_gets_nothing_through(
    page: Page, name: str, asked: str
) -> None:
    async with open_to_anybody() as gateway, elsewhere() as port:
        await page.goto(f"http://{name}:{port}/")
        kept_out(await attempts(page, gateway, asked), gateway)


async def test_a_page_without_an_origin_gets_nothing_through(page: Page, tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    file.write_bytes(PAGE)
    async with open_to_anybody() as gateway:
        await page.goto(file.as_uri())
        kept_out(await attempts(page, gateway), gateway)


async def test_a_frame_in_a_sandbox_gets_nothing_through(page: Page) -> None:
    async with open_to_anybody() as gateway, elsewhere() as port:
        await page.goto(f"http://127.0.0.1:{port}/")
        await page.set_content('<iframe sandbox="allow-scripts allow-forms" srcdoc="<body>">')
        frame = page.frames[1]
        netloc = f"127.0.0.1:{gateway.port}"
        found = await frame.evaluate(ATTEMPTS, [f"http://{netloc}", f"ws://{netloc}/rcp/v1/ws"])
        kept_out(found, gateway)


async def test_a_page_that_is_listed_may_do_all_of_it(page: Page) -> None:
    async with elsewhere() as port:
        origin = f"http://localhost:{port}"
        async with open_to_anybody(f'origins = ["{origin}"]') as gateway:
            gateway.robot.release.set()
            await page.goto(origin)
            found = await attempts(page, gateway)
            for name in (
                "post as text",
                "post as json",
                "put as json",
                "get",
                "get with a header",
                "metrics",
                "events",
                "websocket",
                "websocket of json",
                "xmlhttprequest",
            ):
                assert found[name].startswith("read: "), (name, found[name])
            assert '"limit"' not in found["get"]
            assert '"status":"completed"' in found["put as json"]
            for name in ("image", "script", "frame"):  # these tell no origin
                assert found[name] == "blocked", name
            assert not gateway.robot.started.empty()


async def test_the_gateways_own_page_may_do_all_of_it(page: Page) -> None:
    async with open_to_anybody() as gateway:
        gateway.robot.release.set()
        for name in ("127.0.0.1", "localhost"):
            await page.goto(f"http://{name}:{gateway.port}/")
            found = await attempts(page, gateway, name)
            for attempt in ("get", "put", "execute", "events", "websocket", "image"):
                assert (
                    found[attempt] == "blocked"
                    if attempt == "image"
                    else "read: " in found[attempt]
                )


async def test_a_name_that_was_rebound_to_loopback_is_refused(browser: Browser) -> None:
    async with open_to_anybody() as gateway:
        netloc = f"rebound.localhost:{gateway.port}"  # resolved to loopback by the browser itself
        context = await browser.new_context()
        page = await context.new_page()
        answer = await page.goto(f"http://{netloc}/rcp/v1/context/tenant/alpha/sensor/pose")
        assert answer is not None
        assert answer.status == 403
        await page.goto(f"http://{netloc}/")
        found = await page.evaluate(ATTEMPTS, [f"http://{netloc}", f"ws://{netloc}/rcp/v1/ws"])
        assert not [n for n, t in found.items() if "read: {" in t and '"forbidden"' not in t]
        assert found["websocket"] == "blocked"
        assert untouched(gateway)
        await context.close()
