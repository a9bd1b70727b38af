"""A real Chromium, for every test below this folder that asks for one."""

from __future__ import annotations

import os
import shutil
from collections.abc import AsyncGenerator, Generator

import httpx
import pytest
from playwright.async_api import Browser, Page, async_playwright

from browser.accessible import AXE
from browser.watched import Watched, signed_in
from docs.demo import Demo, demo

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


@pytest.fixture(scope="module")
def anyio_backend() -> str:
    """Keep one event loop for a file, so that the browser lives as long as its tests."""
    return "asyncio"


@pytest.fixture(scope="session")
def chromium() -> str:
    """Return where the browser is; without one there is no test, except where it is a must."""
    named = os.environ.get("RCP_CHROMIUM")
    found = named or next(filter(None, map(shutil.which, _NAMES)), None)
    if found is None:
        reason = "no Chromium: install it (Debian: apt-get install chromium) or set RCP_CHROMIUM"
        if os.environ.get("RCP_CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return found


@pytest.fixture(scope="module")
def axe() -> str:
    """Return axe-core, which is there where the pages were built."""
    if not AXE.is_file():
        reason = "no axe-core: build the pages here (make dashboard)"
        if os.environ.get("RCP_CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return AXE.read_text()


@pytest.fixture(scope="module")
async def browser(chromium: str) -> AsyncGenerator[Browser]:
    """Run a headless browser with a profile of its own."""
    async with async_playwright() as playwright:
        made = await playwright.chromium.launch(executable_path=chromium, args=_FLAGS)
        try:
            yield made
        finally:
            await made.close()


@pytest.fixture
async def page(browser: Browser) -> AsyncGenerator[Page]:
    """Open a tab of its own: no cookies, no cache, no other tab to see."""
    context = await browser.new_context(ignore_https_errors=False)
    context.set_default_timeout(60_000)  # ms
    try:
        yield await context.new_page()
    finally:
        await context.close()


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Generator[Demo]:
    """Run the demo for all tests of a file."""
    with demo(tmp_path_factory.mktemp("runtime")) as found:
        yield found


@pytest.fixture
async def robot(running: Demo) -> AsyncGenerator[httpx.AsyncClient]:
    """Look at the demo's robots past the page, as the operator."""
    headers = {"authorization": f"Bearer {running.key}"}
    async with httpx.AsyncClient(base_url=running.url, headers=headers, timeout=60) as client:
        yield client


@pytest.fixture
async def tab(browser: Browser, running: Demo) -> AsyncGenerator[Watched]:
    """Open the demo's dashboard and log in as the operator."""
    async with signed_in(browser, running.url, running.key, "demo-operator") as found:
        yield found
