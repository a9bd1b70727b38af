"""What a dashboard that is left open costs: frames a second in Chromium, the gateway's CPU, memory over time.

Eight plots of 50 Hz, the scene and a camera are open at once, in a window each, while a rover drives in
circles. `--seconds 1800` watches for half an hour; `--json` is for the test that runs it for a moment.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncGenerator, Generator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from urllib.parse import urlencode

import httpx
import psutil
from playwright.async_api import Browser, CDPSession, Page, async_playwright

KEY = "operator-of-this-benchmark"
CONFIG = """
[transports.asgi]
port = {port}
[plugins.dashboard]
[log]
level = "error"
[[backends]]
use = "sim"
name = "rover-alpha"
tenant = "alpha"
camera_rate = 25
[[backends]]
use = "sim"
name = "rover-beta"
tenant = "beta"
[[keys]]
name = "benchmark"
role = "operator"
key = "{key}"
"""
FIELDS = (
    "/tenant/alpha/sensor/pose#position.x",
    "/tenant/alpha/sensor/pose#position.y",
    "/tenant/alpha/sensor/odometry#twist.linear.x",
    "/tenant/alpha/sensor/odometry#twist.angular.z",
    "/tenant/alpha/sensor/imu#angular_velocity.z",
    "/tenant/alpha/sensor/imu#linear_acceleration.x",
    "/tenant/beta/sensor/pose#position.x",
    "/tenant/beta/sensor/imu#linear_acceleration.z",
)
PAGES = {
    "plots": "plot?" + urlencode([*(("p", field) for field in FIELDS), ("span", "30")]),
    "scene": "scene?robot=rover-alpha",
    "camera": "camera?robot=rover-alpha",
}
FLAGS = (
    *(
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--disable-dev-shm-usage",
        "--no-first-run",
    ),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
SLICE = 5.0  # s between looks at the memory
WARM = 6.0  # s until everything is loaded and drawn
COUNT = """
(seconds) => new Promise((done) => {
  const begun = performance.now();
  let frames = 0, last = begun, longest = 0;
  const count = (now) => {
    frames += 1;
    longest = Math.max(longest, now - last);
    last = now;
    if (now - begun < seconds * 1000) requestAnimationFrame(count);
    else done({ rate: frames / ((now - begun) / 1000), longest });
  };
  requestAnimationFrame(count);
})
"""


@contextmanager
def gateway() -> Generator[tuple[psutil.Process, str]]:
    """Run a gateway with two rovers; yield its process and address."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rcp.toml"
        file.write_text(CONFIG.format(port=port, key=KEY))
        rcpd = Path(sys.executable).with_name("rcpd")
        with subprocess.Popen([rcpd, "serve", file]) as process:
            try:
                url = f"http://127.0.0.1:{port}"
                _wait_for(url)
                yield psutil.Process(process.pid), url
            finally:
                process.terminate()


def _wait_for(url: str) -> None:
    end = time.monotonic() + 60
    while True:
        try:
            httpx.get(url + "/readyz").raise_for_status()
        except httpx.HTTPError:
            if time.monotonic() > end:
                raise
            time.sleep(0.1)
        else:
            return


@asynccontextmanager
async def circling(url: str) -> AsyncGenerator[None]:
    """Keep a rover driving in circles."""
    headers = {"authorization": f"Bearer {KEY}"}
    path = "/rcp/v1/context/tenant/alpha/actuator/cmd_vel?valid_for=1"
    twist = {"linear": {"x": 0.5}, "angular": {"z": 0.8}}

    async def drive() -> None:
        async with httpx.AsyncClient(base_url=url, headers=headers) as client:
            while True:
                (await client.put(path, json=twist)).raise_for_status()
                await asyncio.sleep(0.4)

    task = asyncio.create_task(drive())
    try:
        yield
    finally:
        task.cancel()


async def opened(browser: Browser, url: str, page: str) -> tuple[Page, CDPSession]:
    """Show a page of the dashboard in a window of its own."""
    context = await browser.new_context(viewport={"width": 1366, "height": 860})
    tab = await context.new_page()
    await tab.goto(f"{url}/#/{page}")
    await tab.locator('[data-state="open"]').wait_for()
    return tab, await context.new_cdp_session(tab)


async def heap(session: CDPSession) -> float:
    """Return the MB that the page's objects take after a collection."""
    await session.send("HeapProfiler.collectGarbage")
    found = await session.send("Runtime.getHeapUsage")
    return found["usedSize"] / 1e6


def browser_time() -> float:
    """Return the s of CPU that the browser's processes have taken."""
    times = [
        one.cpu_times()
        for one in psutil.Process().children(recursive=True)
        if "chrom" in one.name()
    ]
    return sum(one.user + one.system for one in times)


async def measure(seconds: float, chromium: str | None) -> dict[str, object]:
    """Watch it for so long; return what it was like."""
    slices = max(2, round(seconds / SLICE))
    frames: dict[str, list[float]] = {name: [] for name in PAGES}
    longest = dict.fromkeys(PAGES, 0.0)
    heaps: dict[str, list[float]] = {name: [] for name in PAGES}
    resident: list[float] = []
    with gateway() as (process, url):
        async with async_playwright() as playwright, circling(url):
            process.cpu_percent()
            await asyncio.sleep(3)
            idle = process.cpu_percent()
            browser = await playwright.chromium.launch(executable_path=chromium, args=FLAGS)
            tabs = {name: await opened(browser, url, page) for name, page in PAGES.items()}
            await asyncio.sleep(WARM)
            process.cpu_percent()
            taken, begun = browser_time(), time.monotonic()
            for _ in range(slices):
                counts = (tab.evaluate(COUNT, SLICE) for tab, _ in tabs.values())
                for name, found in zip(tabs, await asyncio.gather(*counts), strict=True):
                    frames[name].append(found["rate"])
                    longest[name] = max(longest[name], found["longest"])
                for name, (_, session) in tabs.items():
                    heaps[name].append(await heap(session))
                resident.append(process.memory_info().rss / 1e6)
            busy = process.cpu_percent()
            browsing = (browser_time() - taken) / (time.monotonic() - begun) * 100
            await browser.close()
    return {
        "frames": {name: sum(rates) / len(rates) for name, rates in frames.items()},
        "longest": longest,
        "heap": {name: (found[0], found[-1]) for name, found in heaps.items()},
        "cpu": {"without": idle, "with": busy, "browser": browsing},
        "rss": (resident[0], resident[-1]),
        "seconds": slices * SLICE,
    }


def main() -> None:
    """Print a table, or JSON."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--seconds", type=float, default=60)
    arguments.add_argument("--chromium", default=shutil.which("chromium"))
    arguments.add_argument("--json", action="store_true")
    asked = arguments.parse_args()
    found = asyncio.run(measure(asked.seconds, asked.chromium))
    if asked.json:
        print(json.dumps(found))
        return
    print(f"8 plots of 50 Hz, scene and camera at once, {found['seconds']:.0f} s")
    for name in PAGES:
        begun, ended = found["heap"][name]
        print(
            f"  {name:8} {found['frames'][name]:5.1f} frames/s, longest {found['longest'][name]:4.0f} ms, "
            f"heap {begun:5.1f} → {ended:5.1f} MB"
        )
    cpu, rss = found["cpu"], found["rss"]
    print(
        f"  gateway  {cpu['without']:.0f} % of a core without, {cpu['with']:.0f} % with the pages"
    )
    print(f"           {rss[0]:.0f} → {rss[1]:.0f} MB")
    print(f"  browser  {cpu['browser']:.0f} % of a core, all its processes")


if __name__ == "__main__":
    main()
