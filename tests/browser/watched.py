"""A page of the dashboard under watch: nothing may leave the gateway, break a policy or be complained of."""

from __future__ import annotations

import os
import re
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.async_api import (
    Browser,
    ConsoleMessage,
    Page,
    Request,
    WebSocket,
    expect,
)

from rcp_dashboard.pages import STATIC

__all__ = ["SCREENSHOTS", "Watched", "log_in", "require_pages", "signed_in", "watched"]

SCREENSHOTS = Path(os.environ.get("RCP_SCREENSHOTS", "build/screenshots"))
_VIOLATION = """
document.addEventListener("securitypolicyviolation", (event) =>
  console.error(`policy: ${event.effectiveDirective} ${event.blockedURI} ${event.sourceFile}`));
"""
_SCHEMES = {"http": "http", "ws": "http", "https": "https", "wss": "https"}


class Watched:
    """The page, and what was seen to go wrong."""

    def __init__(self, page: Page, url: str) -> None:
        self.page = page
        self.url = url.rstrip("/")
        self.complaints: list[str] = []
        self.strays: list[str] = []
        self.expected: list[str] = ["GL Driver Message", "closed before the connection is est"]
        """Regular expressions of complaints that belong to the test, of drawing in software, and of a
        login that overtakes the connection which is being opened without it."""
        page.on("console", self._console)
        page.on("pageerror", lambda error: self.complaints.append(f"uncaught: {error}"))
        page.on("request", self._request)
        page.on("websocket", self._socket)

    def _console(self, message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            self.complaints.append(f"{message.type}: {message.text} ({message.location['url']})")

    def _request(self, request: Request) -> None:
        self._check(request.url)

    def _socket(self, socket: WebSocket) -> None:
        self._check(socket.url)

    def _check(self, url: str) -> None:
        parts, own = urlsplit(url), urlsplit(self.url)
        if parts.scheme in ("data", "blob"):
            return
        if (_SCHEMES.get(parts.scheme), parts.netloc) != (own.scheme, own.netloc):
            self.strays.append(url)

    async def open(self, page: str = "") -> None:
        """Show one of the pages, by its word behind `#/`."""
        await self.page.goto(f"{self.url}/#/{page}")

    async def connected(self) -> None:
        """Wait until the page is at work."""
        await self.page.locator('[data-state="open"]').wait_for()

    async def shoot(self, name: str) -> None:
        """Take a screenshot for people to look at."""
        await self.page.screenshot(path=SCREENSHOTS / f"{name}.png")

    def check(self) -> None:
        """Fail for whatever went wrong and was not expected."""
        assert not self.strays, f"requests that left {self.url}: {self.strays}"
        wrong = [
            told
            for told in self.complaints
            if not any(re.search(pattern, told) for pattern in self.expected)
        ]
        assert not wrong, "\n".join(wrong)


def require_pages() -> None:
    """Skip the test where the pages are not built, except where they have to be."""
    if not (STATIC / "index.html.gz").is_file():
        reason = "the dashboard's pages are not built: make dashboard"
        if os.environ.get("RCP_CI"):
            pytest.fail(reason)
        pytest.skip(reason)


@asynccontextmanager
async def watched(browser: Browser, url: str, **options: Any) -> AsyncGenerator[Watched]:
    """Open a tab of its own for the dashboard at `url`; check it when left without an error."""
    require_pages()
    desk: dict[str, Any] = {"viewport": {"width": 1366, "height": 860}, "service_workers": "block"}
    context = await browser.new_context(**(desk | options))
    context.set_default_timeout(60_000)  # ms
    context.set_default_navigation_timeout(180_000)  # on a busy machine the first page takes long
    await context.add_init_script(_VIOLATION)
    try:
        found = Watched(await context.new_page(), url)
        yield found
        found.check()
    finally:
        await context.close()


async def log_in(page: Page, key: str) -> None:
    """Log in on the page as a person would."""
    await page.get_by_role("button", name="Log in").first.click()
    dialog = page.get_by_role("dialog")
    await dialog.get_by_label("Key or token").fill(key)
    await dialog.get_by_role("button", name="Log in").click()
    await dialog.wait_for(state="detached")


@asynccontextmanager
async def signed_in(
    browser: Browser, url: str, key: str, name: str, script: str = ""
) -> AsyncGenerator[Watched]:
    """Open the dashboard as the person of a key; `script` runs before the page's own."""
    async with watched(browser, url) as found:
        if script:
            await found.page.add_init_script(script)
        await found.open()
        await found.connected()
        await log_in(found.page, key)
        await expect(found.page.get_by_test_id("principal")).to_have_text(name)
        yield found
