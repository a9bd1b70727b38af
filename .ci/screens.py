"""Photograph the dashboard for `docs/dashboard/`: its pages on a demo that really runs.

Run as `make screens`, and commit the result.
"""

from __future__ import annotations

import asyncio
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.async_api import Page, async_playwright, expect

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from browser.watched import Watched, signed_in  # noqa: E402 - found by the line above
from configuration import table  # noqa: E402
from docs.demo import Demo, demo  # noqa: E402
from serving import ROVER, serving  # noqa: E402

DOCS = ROOT / "docs" / "dashboard"


async def _save(page: Page, name: str) -> None:
    await page.screenshot(path=DOCS / f"{name}.png")
    print(f"docs/dashboard/{name}.png")


async def _drive(page: Page) -> None:
    await page.get_by_role("button", name="Take control").click()
    await expect(page.get_by_test_id("control")).to_contain_text("You have control")
    box = await page.get_by_test_id("stick").first.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    await page.mouse.move(x, y)
    await page.mouse.down()
    await page.mouse.move(x + box["width"] / 8, y - box["height"] / 4, steps=4)
    await page.wait_for_timeout(1500)


async def _parameters(tab: Watched) -> None:
    page = tab.page
    await tab.open("parameters?robot=drone-gamma&group=RTL")
    await page.get_by_role("button", name="Read defaults").click()
    for name, text in (("RTL_ALT", "3000"), ("RTL_SPEED", "800"), ("RTL_LOIT_TIME", "2000")):
        await page.get_by_label(f"Value of {name}", exact=True).fill(text)
    await page.wait_for_timeout(1000)
    await _save(page, "parameters")
    await page.get_by_role("button", name="Discard all").click()


async def _pages(tab: Watched) -> None:
    page = tab.page
    send = tab.page.get_by_role("button", name="Execute", exact=True)
    await tab.open("explore?path=/tenant/beta/action/move_to")
    form = page.get_by_test_id("ask-execute")
    await form.locator("[data-pointer='/position/x'] input").fill("8")
    await form.locator("[data-pointer='/position/y'] input").fill("0")
    await send.click()
    await tab.open("commands")
    await page.wait_for_timeout(1500)
    await _save(page, "commands")
    await tab.open("")
    await page.wait_for_timeout(2000)
    await _save(page, "overview")
    await tab.open("fleet")
    await page.get_by_label("Select rover-alpha").check()
    await page.get_by_label("Select rover-beta").check()
    await page.wait_for_timeout(1500)
    await _save(page, "fleet")
    await tab.open("explore?robot=rover-alpha&path=/tenant/alpha/sensor/odometry")
    await page.wait_for_timeout(1500)
    await _save(page, "explore")
    await _parameters(tab)
    await tab.open("camera?robot=rover-alpha")
    await page.wait_for_timeout(2000)
    await _save(page, "camera")
    await tab.open("scene?robot=rover-beta")
    await page.wait_for_timeout(4000)
    await _save(page, "scene")
    await tab.open("map")
    await page.wait_for_timeout(3000)
    await page.get_by_role("button", name="Fit").click()
    await page.wait_for_timeout(500)
    await _save(page, "map")
    beta = "/tenant/beta/sensor"
    plots = [
        f"{beta}/odometry%23pose.position.x",
        f"{beta}/battery%23voltage",
        f"{beta}/velocity%23linear.x",
        f"{beta}/imu%23angular_velocity.z",
    ]
    await tab.open("plot?span=30&" + "&".join(f"p={one}" for one in plots))
    await page.wait_for_timeout(12_000)
    await _save(page, "plot")
    await tab.open("teleop?robot=rover-alpha")
    await _drive(page)
    await _save(page, "teleop")
    await page.mouse.up()
    await tab.open("layout?robot=rover-alpha")
    await page.wait_for_timeout(4000)
    await _save(page, "layouts")
    await tab.open("log")
    await page.wait_for_timeout(1500)
    await _save(page, "log")


async def _past(tab: Watched) -> None:
    page = tab.page
    await page.wait_for_timeout(20_000)  # of which something is recorded
    await page.keyboard.press("F9")  # an incident
    await page.get_by_test_id("estop-reset").click()
    await page.wait_for_timeout(10_000)
    await tab.open("camera")
    await page.get_by_role("button", name="Last incident").click()
    await page.get_by_label("Length of the time line").select_option("300")
    await page.wait_for_timeout(4000)
    await _save(page, "past")
    await tab.open("recordings")
    await page.get_by_role("button", name="Back to live").click()
    await page.wait_for_timeout(1500)
    await _save(page, "recordings")


async def main(running: Demo, recording: str) -> None:
    """Open each page as the demo's operator, let it fill, and save what is seen."""
    chromium = shutil.which("chromium")
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-dev-shm-usage"]
        )
        async with signed_in(browser, running.url, running.key, "demo-operator") as tab:
            await _pages(tab)
        async with signed_in(browser, recording, "admin-admin-admin", "admin") as tab:
            await _past(tab)
        await browser.close()


if __name__ == "__main__":
    with TemporaryDirectory() as folder, demo(Path(folder)) as started:
        recorder = table("features.recorder", folder=f"{folder}/rec", paths=["/tenant/**"])
        black_box = table("features.recorder.black_box", seconds=5, after=5)
        text = ROVER + table("plugins.dashboard") + recorder + black_box
        with serving(Path(folder) / "rcp.toml", text) as recording:
            asyncio.run(main(started, recording))
