"""What the dashboard costs with very many robots over a long time: memory, long frames and whose they are, CPU.

Fleet and Overview are open in a window each, a third window goes from page to page, and a fourth one is empty. Fleet and
Overview are scrolled and searched meanwhile. What a page's main thread computes, and how long it waits for a core, is read
from `/proc` fifty times a second. So a long frame is told apart. It is the page's, if its thread computed for 100 ms between two
frames; the machine's, if without what its thread waited for a core it would not have been long, or if the empty window had none
at the same time either; else that of what draws, in the browser's other threads.

Run: python benchmarks/dashboard_soak.py [--seconds 1800] [--robots 500] [--json FILE] [--axe]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import AsyncGenerator, Generator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
from crowd import KEY
from dashboard import FLAGS
from playwright.async_api import Browser, CDPSession, Page, async_playwright

HERE = Path(__file__).parent
AXE = HERE.parent / "plugins/rcp_dashboard/web/node_modules/axe-core/axe.min.js"
MINUTE = 60.0  # s between looks at the memory
WARM = 20.0  # s until all is loaded and drawn
LONG = 100.0  # ms
PAGES = {"fleet": "fleet", "overview": ""}
WALK = (
    *("", "fleet", "explore", "teleop?robot=robot-003", "camera", "scene?robot=robot-004", "map"),
    *("plot", "layout", "commands", "people", "alarms", "recordings", "log?level=warning"),
)
WATCH = """
(() => {
  const found = (window.long = { frames: [], scripts: [] });
  const at = (now) => performance.timeOrigin + now;
  let last = performance.now();
  window.frames = 0;
  const next = (now) => {
    window.frames += 1;
    if (now - last > 50) found.frames.push([at(last), at(now)]);
    last = now;
    requestAnimationFrame(next);
  };
  requestAnimationFrame(next);
  new PerformanceObserver((list) => {
    for (const one of list.getEntries()) {
      if (one.duration <= 100) continue;
      const scripts = [...one.scripts].sort((a, b) => b.duration - a.duration).slice(0, 3);
      found.scripts.push([at(one.startTime), one.duration, scripts.map((each) =>
        `${each.duration.toFixed(0)} ms ${each.invoker} ${each.sourceFunctionName} (layout ${each.forcedStyleAndLayoutDuration.toFixed(0)})`)]);
    }
  }).observe({ type: "long-animation-frame", buffered: true });
})();
"""
TAKE = "() => { const all = structuredClone(window.long); window.long.frames = []; window.long.scripts = []; return all; }"
BURN = (
    "() => { const end = performance.now() + 400; while (performance.now() < end) Math.random(); }"
)
VIOLATIONS = """
async () => (await axe.run(document, { resultTypes: ["violations"],
  runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"] })).violations
  .map((one) => `${one.impact} ${one.id}: ${one.nodes.length} of ${one.nodes[0].html.slice(0, 160)}`)
"""


class Threads:
    """What main threads of processes computed and waited, by the time; a thread of its own reads it."""

    def __init__(self) -> None:
        self.pids: dict[str, int] = {}
        self._read: dict[str, list[tuple[float, float, float]]] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._over.wait(0.02):
            now = time.time() * 1000
            for name, pid in list(self.pids.items()):
                told = Path(f"/proc/{pid}/task/{pid}/schedstat").read_bytes().split()
                ran, waited = int(told[0]) / 1e6, int(told[1]) / 1e6
                self._read.setdefault(name, []).append((now, ran, waited))

    def between(self, name: str, begun: float, ended: float) -> tuple[float, float]:
        """Return the ms that a thread computed and waited between two moments, at most."""
        read = self._read.get(name, [])
        before = [one for one in read if one[0] <= begun][-1:] or read[:1]
        after = [one for one in read if one[0] >= ended][:1] or read[-1:]
        if not before or not after:
            return 0.0, 0.0
        return after[0][1] - before[0][1], after[0][2] - before[0][2]

    def forget(self) -> None:
        """Drop what was read more than ten seconds ago."""
        for name, read in self._read.items():
            self._read[name] = [one for one in read if one[0] > time.time() * 1000 - 10_000]

    @contextmanager
    def running(self) -> Generator[None]:
        """Read while entered."""
        self._thread.start()
        try:
            yield
        finally:
            self._over.set()
            self._thread.join()


Pauses = list[tuple[float, float]]
"""Begin and end of each time without a frame for more than 50 ms, in ms since the epoch."""


@dataclass
class Window:
    """A page that is watched, and what was found of it."""

    name: str
    page: Page
    session: CDPSession
    heap: list[float] = field(default_factory=list)
    """MB after a collection, each minute."""
    nodes: list[int] = field(default_factory=list)
    listeners: list[int] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    """Parts of a core that its process took, of each minute."""
    main: list[float] = field(default_factory=list)
    """The same of its main thread."""
    rate: list[float] = field(default_factory=list)
    """Frames a second."""
    machine: int = 0
    """Frames of more than 100 ms that are the machine's."""
    drawing: list[float] = field(default_factory=list)
    """The ms of those of other threads of the browser."""
    longest: float = 0.0
    own: list[dict[str, Any]] = field(default_factory=list)
    """Frames in which its main thread computed for as long."""
    _counted: tuple[float, float, float, int] | None = None

    async def count(self) -> None:
        """Note memory and CPU of the minute that is over."""
        await self.session.send("HeapProfiler.collectGarbage")
        told = await self.session.send("Performance.getMetrics")
        metric = {one["name"]: one["value"] for one in told["metrics"]}
        self.heap.append(metric["JSHeapUsedSize"] / 1e6)
        self.nodes.append(int(metric["Nodes"]))
        self.listeners.append(int(metric["JSEventListeners"]))
        now = time.monotonic(), metric["ProcessTime"], metric["ThreadTime"]
        frames = await self.page.evaluate("window.frames")
        if self._counted is not None:
            taken = now[0] - self._counted[0]
            self.cpu.append((now[1] - self._counted[1]) / taken)
            self.main.append((now[2] - self._counted[2]) / taken)
            self.rate.append((frames - self._counted[3]) / taken)
        self._counted = (*now, frames)
        await self.page.evaluate(TAKE)  # what the collection took is not the page's

    async def take(self, threads: Threads, empty: Pauses) -> Pauses:
        """Note the long frames since the last time, and whose they are; return the pauses between frames."""
        found = await self.page.evaluate(TAKE)
        for begun, ended in found["frames"]:
            if ended - begun <= LONG:
                continue
            ran, waited = threads.between(self.name, begun, ended)
            self.longest = max(self.longest, ended - begun)
            if ran >= LONG:
                scripts = [one for one in found["scripts"] if begun - 50 <= one[0] <= ended]
                told = {"ms": ended - begun, "ran": ran, "waited": waited}
                self.own.append(told | {"at": self.page.url.rpartition("#")[2], "scripts": scripts})
            elif ended - begun - waited <= LONG or any(a < ended and begun < b for a, b in empty):
                self.machine += 1
            else:
                self.drawing.append(ended - begun)
        return found["frames"]


@contextmanager
def crowd(robots: int) -> Generator[tuple[psutil.Process, str]]:
    """Run the gateway with so many robots; yield its process and address."""
    command = [sys.executable, str(HERE / "crowd.py"), str(robots)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            port = int(process.stdout.readline())
            yield psutil.Process(process.pid), f"http://127.0.0.1:{port}"
        finally:
            process.terminate()


async def opened(browser: Browser, name: str, address: str) -> Window:
    """Open a window, logged in where it shows the dashboard."""
    context = await browser.new_context(viewport={"width": 1366, "height": 860}, bypass_csp=True)
    context.set_default_timeout(60_000)
    await context.add_init_script(WATCH)
    page = await context.new_page()
    await page.goto(address)
    if address.startswith("http"):
        await page.get_by_role("button", name="Log in").first.click()
        await page.get_by_label("Key or token").fill(KEY)
        await page.get_by_role("dialog").get_by_role("button", name="Log in").click()
        await page.get_by_test_id("principal").wait_for()
    session = await context.new_cdp_session(page)
    await session.send("Performance.enable", {"timeDomain": "threadTicks"})
    return Window(name, page, session)


async def pid_of(window: Window) -> int:
    """Return the process of a page: the one that is busy when the page is."""
    children = psutil.Process().children(recursive=True)
    renderers = [one for one in children if "--type=renderer" in " ".join(one.cmdline())]
    before = {one.pid: one.cpu_times().user for one in renderers}
    await window.page.evaluate(BURN)
    return max(renderers, key=lambda one: one.cpu_times().user - before[one.pid]).pid


async def use(windows: dict[str, Window], until: float) -> None:
    """Scroll and search as somebody who looks for something."""
    turn = 0
    while time.monotonic() < until:
        turn += 1
        for name in PAGES:
            page = windows[name].page
            await page.mouse.move(500, 600)
            for step in range(20):
                await page.mouse.wheel(0, 400 if turn % 4 < 2 else -400)
                await asyncio.sleep(0.05 + step % 2 * 0.1)
            if turn % 3 == 0:
                search = page.get_by_label("Search robots")
                await search.press_sequentially(f"robot-{turn % 50:02}", delay=120)
                await asyncio.sleep(2)
                await search.fill("")
        await asyncio.sleep(5)


async def walk(window: Window, until: float) -> None:
    """Go from page to page."""
    while time.monotonic() < until:
        for page in WALK:
            await window.page.evaluate("(to) => (location.hash = to)", f"#/{page}")
            await asyncio.sleep(6)


async def take(windows: dict[str, Window], threads: Threads) -> None:
    """Note the long frames of all."""
    found = await windows["empty"].take(threads, [(0.0, math.inf)])
    for window in windows.values():
        if window.name != "empty":
            await window.take(threads, found)


async def look(windows: dict[str, Window], threads: Threads, until: float) -> None:
    """Note what there is each minute, and long frames each second, until then."""
    minute = 0.0
    while time.monotonic() < until:
        if time.monotonic() >= minute:
            await take(windows, threads)
            for window in windows.values():
                await window.count()
            threads.forget()
            minute = time.monotonic() + MINUTE
            load = os.getloadavg()[0]
            heaps = " ".join(f"{name} {one.heap[-1]:.1f}" for name, one in windows.items())
            own = " ".join(f"{len(one.own)}/{len(one.drawing)}" for one in windows.values())
            print(f"  load {load:.1f}; MB {heaps}; long frames {own}", file=sys.stderr, flush=True)
        await asyncio.sleep(1)
        await take(windows, threads)


async def check(window: Window) -> dict[str, list[str]]:
    """Return what axe finds on each page."""
    found: dict[str, list[str]] = {}
    await window.page.evaluate(AXE.read_text())
    for page in WALK:
        await window.page.evaluate("(to) => (location.hash = to)", f"#/{page}")
        await asyncio.sleep(4)
        found[page or "overview"] = await window.page.evaluate(VIOLATIONS)
    return found


@asynccontextmanager
async def chromium(path: str | None) -> AsyncGenerator[Browser]:
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=path, args=FLAGS)
        try:
            yield browser
        finally:
            await browser.close()


async def measure(asked: argparse.Namespace) -> dict[str, Any]:
    """Watch for so long; return what was found."""
    threads = Threads()
    with crowd(asked.robots) as (process, url):
        async with chromium(asked.chromium) as browser:
            addresses = {name: f"{url}/#/{page}" for name, page in PAGES.items()}
            addresses |= {"walking": f"{url}/#/", "empty": "about:blank"}
            windows = {name: await opened(browser, name, to) for name, to in addresses.items()}
            await asyncio.sleep(min(WARM, asked.seconds))
            if asked.axe:
                return {"axe": await check(windows["walking"])}
            for name, window in windows.items():
                threads.pids[name] = await pid_of(window)
            process.cpu_percent()
            resident = process.memory_info().rss / 1e6
            until = time.monotonic() + asked.seconds
            with threads.running():
                async with asyncio.TaskGroup() as group:
                    group.create_task(use(windows, until))
                    group.create_task(walk(windows["walking"], until))
                    group.create_task(look(windows, threads, until))
            cpu = process.cpu_percent() / 100
            for window in windows.values():
                await window.count()
    drop = {"page", "session", "_counted"}
    return {
        "windows": {
            name: {key: value for key, value in vars(window).items() if key not in drop}
            for name, window in windows.items()
        },
        "gateway": {"cpu": cpu, "rss": resident},
        "load": os.getloadavg(),
    }


def table(found: dict[str, Any]) -> None:
    """Print what was found."""
    for name, one in found["windows"].items():
        heap, nodes = one["heap"], one["nodes"]
        third = max(1, len(heap) // 3)
        mean = [sum(part) / len(part) for part in (heap[:third], heap[-third:])]
        print(
            f"  {name:9} heap {mean[0]:5.1f} → {mean[1]:5.1f} MB, nodes {min(nodes)} to {max(nodes)}, "
            f"{sum(one['cpu']) / max(1, len(one['cpu'])):.0%} of a core, "
            f"{sum(one['rate']) / max(1, len(one['rate'])):.0f} frames/s"
        )
        print(
            f"            frames over 100 ms: {len(one['own'])} of the page, {len(one['drawing'])} of drawing, "
            f"{one['machine']} of the machine, longest {one['longest']:.0f} ms"
        )
        for frame in sorted(one["own"], key=lambda frame: -frame["ran"])[:5]:
            print(f"            {frame['ran']:.0f} ms of {frame['ms']:.0f} at {frame['at']}")
            for _, ms, scripts in frame["scripts"]:
                print(f"              {ms:.0f} ms: {'; '.join(scripts)}")
    print(f"  gateway   {found['gateway']['cpu']:.0%} of a core; load {found['load'][0]:.1f}")


def main() -> None:
    """Print a table, and write all of it as JSON."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--seconds", type=float, default=1800)
    arguments.add_argument("--robots", type=int, default=500)
    arguments.add_argument("--chromium", default=shutil.which("chromium"))
    arguments.add_argument("--json", type=Path)
    arguments.add_argument("--axe", action="store_true", help="run axe on every page instead")
    asked = arguments.parse_args()
    found = asyncio.run(measure(asked))
    if asked.json:
        asked.json.write_text(json.dumps(found, indent=1))
    if asked.axe:
        for page, violations in found["axe"].items():
            print(page, *violations or ["no violation"], sep="\n  ")
    else:
        table(found)


if __name__ == "__main__":
    main()
