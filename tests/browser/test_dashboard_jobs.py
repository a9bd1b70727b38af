"""Every job that the documentation lists is done by the keyboard alone, and by fingers on a phone."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack
from typing import Any

import pytest
from playwright.async_api import Browser, expect

import browser.jobs.arranging
import browser.jobs.moving
import browser.jobs.watching  # noqa: F401 - these register how jobs are done
from browser.jobs.board import JOBS, listed
from browser.jobs.hands import Fingers, Hands, Keys
from browser.jobs.site import KEYS, Site, site
from browser.watched import Watched, log_in, watched

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
PHONE: dict[str, Any] = {
    "viewport": {"width": 390, "height": 844},
    "has_touch": True,
    "is_mobile": True,
}
WAYS: dict[type[Hands], dict[str, Any]] = {Keys: {}, Fingers: PHONE}


@pytest.fixture(scope="module")
async def gateway(tmp_path_factory: pytest.TempPathFactory) -> AsyncGenerator[Site]:
    async with site(tmp_path_factory.mktemp("jobs")) as made:
        yield made


@pytest.fixture(scope="module")
async def seats(browser: Browser, gateway: Site) -> AsyncGenerator[dict[type[Hands], Watched]]:
    """Sit at a computer and at a phone, logged in."""
    async with AsyncExitStack() as stack:
        found: dict[type[Hands], Watched] = {}
        for way, options in WAYS.items():
            tab = await stack.enter_async_context(watched(browser, gateway.url, **options))
            await tab.open()
            await log_in(tab.page, KEYS["ada"])
            await expect(tab.page.get_by_test_id("principal")).to_have_text("ada")
            found[way] = tab
        yield found


def test_the_documentation_lists_the_jobs_that_are_done_here() -> None:
    assert sorted(listed()) == sorted(JOBS)


@pytest.mark.parametrize("way", [Keys, Fingers], ids=["keyboard", "touch"])
@pytest.mark.parametrize("words", listed())
async def test_a_job_is_done(
    seats: dict[type[Hands], Watched], gateway: Site, axe: str, words: str, way: type[Hands]
) -> None:
    tab = seats[way]
    await tab.page.goto("about:blank")
    await tab.open()
    await tab.connected()
    await JOBS[words](way(tab.page, axe), gateway)
