"""Photograph the dashboard for `docs/dashboard/`: its pages with simulated robots that really run.

Run as `make screens`, or with names (`make screens ARGS="scene map"`), look at all of them, and commit them.
"""

from __future__ import annotations

import asyncio
import io
import shutil
import subprocess
import sys
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx
from PIL import Image
from playwright.async_api import Page, async_playwright, expect

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from browser.input_helpers import held  # noqa: E402 - found by the line above
from browser.watched import Watched, signed_in  # noqa: E402
from configuration import backend, key, listener, table  # noqa: E402
from docs.demo import demo  # noqa: E402
from serving import ROVER, serving  # noqa: E402

expect.set_options(timeout=120_000)  # ms
DOCS = ROOT / "docs" / "dashboard"
FLAGS = ["--no-sandbox", "--disable-dev-shm-usage"]
FAULT = {"fault": "link_lost", "seconds": 60}
DRAWN = """
const real = WebGL2RenderingContext.prototype.getExtension;
WebGL2RenderingContext.prototype.getExtension = function (name) {
  return name === "WEBGL_debug_renderer_info" ? null : real.call(this, name);
};
"""
"""The page does not know that the processor draws: its scene is as sharp as with a graphics card."""
PLOTTED = (
    "odometry%23pose.position.x",
    "battery%23voltage",
    "velocity%23linear.x",
    "imu%23angular_velocity.z",
)
HOME = (-35.3632621, 149.1652374)
"""Latitude and longitude of the simulated copter."""
AREA = ((-110, 90), (20, 110), (120, 80), (125, -85), (-105, -95))
ROUTE = ((50, 40), (95, -15), (15, -65), (-70, -40))
"""In m east and north of its home."""
HEIGHT = 20  # m
DRIVE = 100  # s that a rover may take to where it is sent

Shot = Callable[["Photographer"], Awaitable[None]]


class Photographer:
    """A page, the gateway past it, and where pictures go."""

    def __init__(self, tab: Watched, robots: httpx.AsyncClient) -> None:
        self.tab = tab
        self.page = tab.page
        self._robots = robots

    async def open(self, page: str, wait: float = 1.5) -> Page:
        """Show a page, and let it fill for so many seconds."""
        await self.page.mouse.move(1, 1)  # over nothing that would answer to it
        await self.tab.open(page)
        await self.wait(wait)
        return self.page

    async def wait(self, seconds: float) -> None:
        """Let robots and page go on."""
        await self.page.wait_for_timeout(seconds * 1000)

    async def ask(self, path: str, value: Any = None, *, wait: int = 0) -> None:
        """Execute something; the answer comes when it is done within so many seconds."""
        parameters = {"wait": wait} if wait else {}
        answer = await self._robots.post(f"/rcp/v1/context{path}", json=value, params=parameters)
        if answer.is_error:
            raise RuntimeError(f"{path}: {answer.text}")

    async def drive(self, tenant: str, x: float, y: float, *, arrive: bool = False) -> None:
        """Send the rover of a tenant to a place, wherever it was going."""
        await self.ask(f"/tenant/{tenant}/service/hold", wait=20)
        place = {"position": {"x": x, "y": y}}
        wait = DRIVE if arrive else 0
        await self.ask(f"/tenant/{tenant}/action/move_to", place, wait=wait)

    async def save(self, name: str) -> None:
        """Keep what is seen."""
        path = DOCS / f"{name}.png"
        shot = Image.open(io.BytesIO(await self.page.screenshot())).convert("RGB")
        shot.save(path, optimize=True)
        print(f"{path.relative_to(ROOT)} {path.stat().st_size // 1000} kB")


async def overview(at: Photographer) -> None:
    """Drive a rover meanwhile."""
    await at.drive("beta", 3, 1.5)
    await at.open("", 3)
    await at.save("overview")


async def fleet(at: Photographer) -> None:
    """Select two of the robots."""
    page = await at.open("fleet")
    await page.get_by_label("Select rover-alpha").check()
    await page.get_by_label("Select rover-beta").check()
    await at.wait(1.5)
    await at.save("fleet")


async def commands(at: Photographer) -> None:
    """End one command, and show another while it runs."""
    await at.drive("beta", 0.5, 0, arrive=True)
    await at.drive("beta", 8, 0)
    await at.drive("alpha", -3, 1)
    await at.open("commands", 4)
    await at.save("commands")


async def explore(at: Photographer) -> None:
    """Look at the odometry of a rover that drives."""
    await at.drive("alpha", 3, 0)
    await at.open("explore?robot=rover-alpha&path=/tenant/alpha/sensor/odometry", 4)
    await at.save("explore")


async def parameters(at: Photographer) -> None:
    """Change three parameters without writing them."""
    page = await at.open("parameters?robot=drone-gamma&group=RTL")
    await page.get_by_role("button", name="Read defaults").click()
    for name, text in (("RTL_ALT", "3000"), ("RTL_SPEED", "800"), ("RTL_LOIT_TIME", "2000")):
        await page.get_by_label(f"Value of {name}", exact=True).fill(text)
    await at.wait(1)
    await at.save("parameters")
    await page.get_by_role("button", name="Discard all").click()


async def camera(at: Photographer) -> None:
    """Look through the rover's camera from another place than its start."""
    await at.drive("alpha", 0, 2, arrive=True)
    await at.open("camera?robot=rover-alpha", 2)
    await at.save("camera")


async def scene(at: Photographer) -> None:
    """Come nearer to a rover that drives along its path."""
    await at.drive("beta", 0, 0, arrive=True)
    page = await at.open("scene?robot=rover-beta", 3)
    await at.drive("beta", 4, 2)
    canvas = page.get_by_role("application")
    for presses in ("+", "+", "ArrowLeft"):
        await canvas.press(presses)
    await canvas.blur()
    await at.wait(2)
    await at.save("scene")


async def plot(at: Photographer) -> None:
    """Plot four values of a rover that drives."""
    plots = "&".join(f"p=/tenant/beta/sensor/{one}" for one in PLOTTED)
    page = await at.open(f"plot?span=30&{plots}", 4)
    await at.drive("beta", 0, 0, arrive=True)
    await at.drive("beta", 4, 2)
    await at.wait(8)
    await page.evaluate("document.activeElement?.blur()")
    await at.save("plot")


async def layouts(at: Photographer) -> None:
    """Show the layout that a rover has by itself, while it drives."""
    await at.open("layout?robot=rover-alpha", 3)
    await at.drive("alpha", 3, -1)
    await at.wait(9)
    await at.save("layouts")


async def teleop(at: Photographer) -> None:
    """Hold the stick of a rover."""
    await at.ask("/tenant/alpha/service/hold", wait=20)
    page = await at.open("teleop?robot=rover-alpha")
    await page.get_by_role("button", name="Take control").click()
    await expect(page.get_by_test_id("control")).to_contain_text("You have control")
    box = await page.get_by_test_id("stick").first.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    await page.mouse.move(x, y)
    await page.mouse.down()
    await page.mouse.move(x + box["width"] / 8, y - box["height"] / 4, steps=4)
    await at.wait(1.5)
    await at.save("teleop")
    await page.mouse.up()
    await page.get_by_role("button", name="Release control").click()


async def log(at: Photographer) -> None:
    """Show what the robots told."""
    await at.open("log")
    await at.save("log")


async def stop(at: Photographer) -> None:
    """Stop all, one of them out of reach."""
    page = await at.open("?q=rover")
    await at.ask("/tenant/beta/service/inject_fault", FAULT)
    await at.wait(1)
    await page.keyboard.press("F9")
    await expect(page.get_by_test_id("stop-missing")).to_contain_text("rover-beta")
    await at.wait(1)
    await at.save("stop")


async def above(at: Photographer) -> None:
    """Fly a copter to a goal over the tiles."""
    await at.ask("/tenant/alpha/action/set_mode", {"mode": "GUIDED"}, wait=30)
    await at.ask("/tenant/alpha/action/arm", wait=30)
    await at.ask("/tenant/alpha/action/takeoff", {"altitude": HEIGHT}, wait=60)
    page = await at.open("map", 2)
    north, east = HOME[0] + 60 / 111_195, HOME[1] + 45 / 90_700
    await at.ask("/tenant/alpha/action/move_to", {"latitude": north, "longitude": east})
    await at.wait(8)
    await page.get_by_role("button", name="Fit").click()
    for _ in range(3):
        await page.get_by_role("button", name="Zoom out").click()
    await at.wait(2)
    await at.save("map")
    await at.ask("/tenant/alpha/action/rtl", wait=120)


async def mission(at: Photographer) -> None:
    """Fly a mission within a fence."""
    places = [(HOME[0] + north / 111_195, HOME[1] + east / 90_700) for east, north in AREA]
    corner = {"command": "NAV_FENCE_POLYGON_VERTEX_INCLUSION", "params": [float(len(places))]}
    area = [corner | {"latitude": lat, "longitude": lon} for lat, lon in places]
    await at.ask("/tenant/alpha/service/fence/upload", {"items": area}, wait=30)
    items: list[dict[str, Any]] = [{"command": "NAV_TAKEOFF", "altitude": HEIGHT}]
    for east, north in ROUTE:
        place = {"latitude": HOME[0] + north / 111_195, "longitude": HOME[1] + east / 90_700}
        items.append({"command": "NAV_WAYPOINT", "altitude": HEIGHT} | place)
    items.append({"command": "NAV_RETURN_TO_LAUNCH"})
    await at.ask("/tenant/alpha/action/mission/upload", {"items": items}, wait=30)
    page = await at.open("map", 2)
    await page.get_by_test_id("plan").click()
    await expect(page.get_by_test_id("onboard")).to_contain_text("6 items")
    await at.wait(1)
    await page.get_by_role("button", name="Fit").click()
    await at.ask("/tenant/alpha/action/set_mode", {"mode": "GUIDED"}, wait=30)
    await at.ask("/tenant/alpha/action/arm", wait=30)
    async with held(page.get_by_role("button", name="Run the mission")):
        await expect(page.get_by_test_id("goal-status")).to_contain_text("running")
    await expect(page.get_by_text("Item 4 of 6")).to_be_visible()
    await at.wait(1)
    await at.save("mission")


async def past(at: Photographer) -> None:
    """Look back at an e-stop of a rover that drove."""
    await at.open("", 15)
    await at.drive("alpha", 3, 1.5)
    await at.wait(6)
    await at.page.keyboard.press("F9")  # an incident
    await at.page.get_by_test_id("estop-reset").click()
    await at.wait(10)
    page = await at.open("camera")
    await page.get_by_role("button", name="Last incident").click()
    await page.get_by_label("Length of the time line").select_option("300")
    await at.wait(4)
    await at.save("past")
    await page.get_by_role("button", name="Back to live").click()


async def recordings(at: Photographer) -> None:
    """Show the recordings and the incident."""
    await at.open("recordings")
    await at.save("recordings")


DEMO: dict[str, Shot] = {
    "overview": overview,
    "fleet": fleet,
    "commands": commands,
    "explore": explore,
    "parameters": parameters,
    "camera": camera,
    "scene": scene,
    "plot": plot,
    "layouts": layouts,
    "log": log,
    "teleop": teleop,
    "stop": stop,
}
FIELD: dict[str, Shot] = {"map": above, "mission": mission}
RECORDED: dict[str, Shot] = {"past": past, "recordings": recordings}


async def take(shots: dict[str, Shot], url: str, secret: str, person: str) -> None:
    """Log in to a gateway and photograph its pages."""
    headers = {"authorization": f"Bearer {secret}"}
    async with AsyncExitStack() as stack:
        playwright = await stack.enter_async_context(async_playwright())
        browser = await playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=FLAGS
        )
        stack.push_async_callback(browser.close)
        robots = httpx.AsyncClient(base_url=url, headers=headers, timeout=150)
        await stack.enter_async_context(robots)
        tab = await stack.enter_async_context(signed_in(browser, url, secret, person, DRAWN))
        for shot in shots.values():
            await shot(Photographer(tab, robots))


def field(folder: Path) -> str:
    """Return the configuration of a copter above tiles of an invented airfield."""
    tiles = folder / "field.pmtiles"
    make = ROOT / "examples" / "tiles" / "make.py"
    subprocess.run([sys.executable, make, tiles], check=True)  # noqa: S603 - a script of this repository
    copter = backend("drone", use="mavlink", links=["sim:copter"], on_loss="hold")
    twin = table("backends.twin", warmup=0.5, speed=2, noise=0)
    pages = table("plugins.dashboard", tiles=str(tiles))
    return listener() + pages + copter + twin + key("operator", "operator-operator")


def recorded(folder: Path) -> str:
    """Return the configuration of a rover that is recorded."""
    recorder = table("features.recorder", folder=f"{folder}/rec", paths=["/tenant/**"])
    black_box = table("features.recorder.black_box", seconds=5, after=5)
    return ROVER + table("plugins.dashboard") + recorder + black_box


def chosen(shots: dict[str, Shot], names: list[str]) -> dict[str, Shot]:
    """Return those that are asked for; all without names."""
    return {name: shot for name, shot in shots.items() if not names or name in names}


def main(names: list[str]) -> None:
    """Photograph what is asked for, from each gateway that has some of it."""
    unknown = set(names) - set(DEMO | FIELD | RECORDED)
    if unknown:
        raise SystemExit(f"no such picture: {', '.join(sorted(unknown))}")
    with TemporaryDirectory() as made:
        folder = Path(made)
        if shots := chosen(DEMO, names):
            with demo(folder) as running:
                asyncio.run(take(shots, running.url, running.admin, "demo-admin"))
        if shots := chosen(FIELD, names):
            with serving(folder / "field.toml", field(folder)) as url:
                asyncio.run(take(shots, url, "operator-operator", "operator"))
        if shots := chosen(RECORDED, names):
            with serving(folder / "recorded.toml", recorded(folder)) as url:
                asyncio.run(take(shots, url, "admin-admin-admin", "admin"))


if __name__ == "__main__":
    main(sys.argv[1:])
