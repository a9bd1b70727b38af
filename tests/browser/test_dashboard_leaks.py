"""What a page takes of a browser is given back: pictures, textures, windows into the scene; and no value outlives who may see it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest
from playwright.async_api import Browser, Page, expect

from browser.machines import Machine, Machines, key_of, machines
from browser.meshes import PACKAGE, write
from browser.watched import Watched, log_in, signed_in
from rcp_kernel.model import Resource
from rcp_kernel.types import Twist

pytestmark = pytest.mark.anyio
expect.set_options(timeout=60_000)  # ms
_BOUND = 60.0  # s
_COUNTING = """
(() => {
  const counted = (window.counted = { urls: 0, made: 0, textures: 0, windows: 0 });
  const before = (of, name, count) => {
    const was = of[name];
    of[name] = function (...given) {
      count(...given);
      return was.apply(this, given);
    };
  };
  before(URL, "createObjectURL", () => (counted.urls += 1));
  before(URL, "revokeObjectURL", () => (counted.urls -= 1));
  before(HTMLCanvasElement.prototype, "getContext", (kind) => (counted.windows += kind === "webgl2" ? 1 : 0));
  const gl = WebGL2RenderingContext.prototype;
  before(gl, "createTexture", () => ((counted.textures += 1), (counted.made += 1)));
  before(gl, "deleteTexture", (one) => (counted.textures -= one ? 1 : 0));
})();
"""
_ROBOT = """<robot name="r"><link name="{name}"><visual><geometry>
<mesh filename="package://{package}/meshes/green.dae"/></geometry></visual></link></robot>"""


@pytest.fixture(scope="module")
async def running(tmp_path_factory: pytest.TempPathFactory) -> AsyncGenerator[Machines]:
    folder: Path = tmp_path_factory.mktemp("looks")
    write(folder)
    async with machines() as made:
        for name in ("meshes/green.dae", "textures/green one.png"):
            made.by["alpha"].files[name] = (folder / name).read_bytes()
        yield made


@pytest.fixture
async def tab(browser: Browser, running: Machines) -> AsyncGenerator[Watched]:
    key = key_of("otto")
    async with signed_in(browser, running.url, key, "otto", _COUNTING) as found:
        yield found


def describe(machine: Machine, name: str) -> None:
    """Have the machine tell how it looks: a square with a picture on it."""
    machine.host.publish("param/robot_description", _ROBOT.format(name=name, package=PACKAGE))


async def until(page: Page, so: str) -> None:
    async with asyncio.timeout(_BOUND):
        while not await page.evaluate(so):  # noqa: ASYNC110 - the page's policy forbids to wait there
            await asyncio.sleep(0.05)


async def counted(page: Page, what: str) -> int:
    return await page.evaluate(f"counted.{what}")


async def test_pictures_of_a_robot_are_given_back_when_the_scene_is_left(
    tab: Watched, running: Machines
) -> None:
    page, machine = tab.page, running.by["alpha"]
    describe(machine, "base_link")
    for _ in range(3):
        await tab.open("scene?robot=one")
        await until(page, "counted.urls > 0")
        await tab.open("log")
        await until(page, "counted.urls === 0")
    machine.held.clear()  # the picture comes when nobody draws it any more
    while not machine.asked.empty():
        machine.asked.get_nowait()
    await tab.open("scene?robot=one")
    async with asyncio.timeout(_BOUND):
        assert (await machine.asked.get()).endswith("green.dae")
        machine.held.set()
        machine.held.clear()
        assert (await machine.asked.get()).endswith("green one.png")
    await tab.open("explore?path=/tenant/alpha/param/serial")
    machine.held.set()
    await page.get_by_role("button", name="Read now").click()  # its answer comes after the picture
    await expect(page.get_by_test_id("value")).to_contain_text("0")
    assert await counted(page, "urls") == 0


async def test_what_was_drawn_of_a_robot_is_given_back_when_it_is_described_anew(
    tab: Watched, running: Machines
) -> None:
    page, machine = tab.page, running.by["alpha"]
    await tab.open("scene?robot=one")
    await expect(page.get_by_test_id("scene")).to_have_attribute("data-drawn", "2d")
    there: list[int] = []
    for turn in range(6):
        made = await counted(page, "made")
        describe(machine, f"link_{turn}")
        link = page.locator(f"[data-testid=layer][data-layer=link][data-path=link_{turn}]")
        await expect(link).to_be_attached()
        await until(page, f"counted.made > {made}")
        there.append(await counted(page, "textures"))
    await until(page, f"counted.textures < {there[0] + 3}")


async def test_the_small_scene_stays_when_the_theme_or_the_tree_changes(
    tab: Watched, running: Machines
) -> None:
    page = tab.page
    await tab.open("teleop?robot=one")
    await page.get_by_role("button", name="Scene", exact=True).click()
    await expect(page.get_by_test_id("inset").locator("canvas")).to_be_visible()
    windows = await counted(page, "windows")
    theme = await page.locator("html").get_attribute("data-theme")
    await page.get_by_role("button", name="Switch to").click()
    await expect(page.locator("html")).not_to_have_attribute("data-theme", theme or "")
    arm = Resource(name="actuator/other", description="Drives.", value=Twist, safe=Twist())
    running.by["alpha"].host.declare(arm)
    await expect(page.get_by_label("Actuator")).to_be_visible()
    assert await counted(page, "windows") == windows
    running.by["alpha"].host.withdraw("actuator/other")


async def test_a_plot_shows_nothing_of_what_the_next_person_may_not_see(
    tab: Watched, running: Machines
) -> None:
    page = tab.page
    tab.expected.append("404")  # what was before of what it may not see
    ends = "sensor/pose%23position.x"
    await tab.open(f"plot?p=/tenant/alpha/{ends}&p=/tenant/beta/{ends}&span=60")
    shown = page.get_by_test_id("shown")
    for at, tenant in enumerate(("alpha", "beta")):
        running.by[tenant].come(3)
        await expect(shown.nth(at)).to_contain_text("3.0000")
    await page.get_by_role("button", name="Log out").click()
    await log_in(page, key_of("gil"))
    await expect(page.get_by_test_id("principal")).to_have_text("gil")
    running.by["beta"].come(4)
    await expect(shown.nth(1)).to_contain_text("4.0000")
    await expect(shown.nth(0)).to_contain_text("\u2013")


async def test_pages_follow_the_machines_of_a_gateway_that_was_started_again(
    browser: Browser,
) -> None:
    async with AsyncExitStack() as first:
        before = await first.enter_async_context(machines())
        port = int(before.url.rpartition(":")[2])
        async with signed_in(browser, before.url, key_of("otto"), "otto") as tab:
            page = tab.page
            tab.expected.append("WebSocket|Failed to load resource")
            await tab.open("plot?p=/tenant/alpha/sensor/pose%23position.x&span=60")
            before.by["alpha"].come(3)
            await expect(page.get_by_test_id("shown")).to_contain_text("3.0000")
            await first.aclose()
            await expect(page.get_by_test_id("gone")).to_be_visible()
            async with machines(port=port, absent=True) as after:
                await expect(page.locator('[data-state="open"]')).to_be_visible()
                after.by["alpha"].come(4)
                async with asyncio.timeout(_BOUND):
                    while "5.0000" not in await page.get_by_test_id("shown").inner_text():
                        after.by["alpha"].come(5)
                        await asyncio.sleep(0.2)
