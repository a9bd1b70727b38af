"""Whether the gateway's memory stays flat while clients come, work and go.

A real `rcpd` with a simulated rover and a store. Each turn a client comes over WebSocket (every other one
takes its leave, the rest just go), over SSE and over HTTP; it subscribes, commands, reads and leaves.
Prints a line a sample, then the verdict: is every sample after the warm-up within 5 % of their median?
Run: python benchmarks/soak.py [SECONDS=600] [TURNS A SECOND=2]
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import httpx
import psutil
from websockets.asyncio.client import connect

SECONDS = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
RATE = float(sys.argv[2]) if len(sys.argv) > 2 else 2.0  # turns a second
AT_ONCE = 8  # turns
SAMPLES = 120
WARM = 1 / 4  # of the time: the rings, the histories and the pools of the allocator fill
FLAT = 0.05
BASE = "/rcp/v1"
RESET = "/service/reset_system"
CONFIG = """
log = {{ level = "error" }}
anonymous = {{ role = "operator", tenants = ["soak"] }}
limits = {{ session_ttl = 5 }}
store = {{ path = "{store}" }}
[transports.asgi]
port = 0
[[backends]]
use = "sim"
tenant = "soak"
rate = 10
map_resolution = 0.2
"""


class WebSocketClient:
    """Says hello, subscribes, commands, waits for updates and goes, with or without a word."""

    def __init__(self, url: str) -> None:
        self.url = url.replace("http", "ws", 1) + BASE + "/ws"

    async def turn(self, number: int) -> None:
        async with connect(self.url, proxy=None) as socket:
            await self._ask(socket, "hello", id="h")
            await self._ask(socket, "subscribe", id="s", path="/sensor/*")
            await self._ask(socket, "read", id="r", path="/sensor/*")
            await self._ask(socket, "write", id="w", path="/param/speed_limit", body=1.0)
            await self._ask(socket, "execute", id="e", path=RESET)
            await self._ask(socket, "write", id="v", path="/actuator/cmd_vel", body={}, valid_for=1)
            await self._update(socket)
            if number % 2:
                await self._ask(socket, "unsubscribe", id="u", body={"subscription": "s"})
            else:
                socket.transport.abort()

    @staticmethod
    async def _ask(socket, type_: str, **fields) -> None:
        await socket.send(json.dumps({"type": type_, **fields}))
        async for text in socket:
            reply = json.loads(text)
            if reply.get("id") == fields["id"] and reply["type"] == type_ and final(reply):
                return

    @staticmethod
    async def _update(socket) -> None:
        async for text in socket:
            if json.loads(text)["type"] == "update":
                return


class WebClient:
    """The same over HTTP, with updates over SSE; a connection of its own each turn."""

    def __init__(self, url: str) -> None:
        self.url = url + BASE

    async def turn(self, _number: int) -> None:
        async with httpx.AsyncClient(base_url=self.url, trust_env=False, timeout=30) as http:
            await ok(http.get("/context/sensor/pose"))
            await ok(http.put("/context/param/speed_limit", json=1.0))
            await ok(http.post(f"/context{RESET}", params={"wait": 10}))
            await ok(http.get("/discovery", params={"path": "/**"}))
            await ok(http.post("/messages", json={"type": "read", "id": "1", "path": "/sensor/*"}))
            async with http.stream("GET", "/events", params={"path": "/sensor/*"}) as events:
                async for line in events.aiter_lines():
                    if line == "event: update":
                        break


def final(reply) -> bool:
    if reply["status"] in ("failed", "rejected"):
        raise AssertionError(reply)
    return reply["status"] == "completed"


async def ok(asked) -> None:
    answer = await asked
    assert answer.status_code == 200, answer.text


async def clients(url: str, until: float) -> Counter[str]:
    """Take turns at a steady rate until then; return how many there were, and how many failed of what."""
    kinds = WebSocketClient(url), WebClient(url)
    loop, number, due = asyncio.get_running_loop(), 0, time.monotonic()
    ended: Counter[str] = Counter()
    under_way: set[asyncio.Task[None]] = set()
    while time.monotonic() < until:
        if len(under_way) >= AT_ONCE:  # a machine that is busy gets fewer turns, not more at once
            await asyncio.wait(under_way, return_when=asyncio.FIRST_COMPLETED)
        for kind in kinds:
            under_way.add(loop.create_task(kind.turn(number)))
        due = max(due + 1 / RATE, time.monotonic())
        await asyncio.sleep(due - time.monotonic())
        number += 1
        done = {task for task in under_way if task.done()}
        under_way -= done
        ended.update(outcome(task.exception()) for task in done)
    ended.update(map(outcome, await asyncio.gather(*under_way, return_exceptions=True)))
    return ended


def outcome(error: BaseException | None) -> str:
    return "turns done" if error is None else f"failed: {type(error).__name__} {error!s:.200}"


async def soak(url: str, rcpd: psutil.Process) -> list[float]:
    """Sample the process while clients work; return its resident megabytes after the warm-up."""
    begun = time.monotonic()
    work = asyncio.create_task(clients(url, begun + SECONDS))
    kept: list[float] = []
    print(f"{'s':>7} {'MB':>7} {'CPU s':>7} {'files':>5} {'threads':>7}")
    for number in range(1, SAMPLES + 1):
        await asyncio.wait([work], timeout=begun + SECONDS * number / SAMPLES - time.monotonic())
        rss, cpu = rcpd.memory_info().rss / 1e6, sum(rcpd.cpu_times()[:2])
        spent = time.monotonic() - begun
        print(
            f"{spent:7.0f} {rss:7.2f} {cpu:7.1f} {rcpd.num_fds():5} {rcpd.num_threads():7}",
            flush=True,
        )
        if spent >= WARM * SECONDS:
            kept.append(rss)
        if work.done():
            break
    for what, count in (await work).most_common():
        print(f"{count:7} {what}")
    return kept


def served(home: Path) -> tuple[subprocess.Popen[str], str]:
    config = home / "rcp.toml"
    config.write_text(CONFIG.format(store=home / "store.sqlite"))
    start = "from rcpd.cli import main; main()"  # with whatever PYTHONPATH says
    rcpd = [sys.executable, "-c", start, "serve", str(config)]
    process = subprocess.Popen(rcpd, stderr=subprocess.PIPE, text=True)
    assert process.stderr
    for line in process.stderr:
        if "serving on " in line:
            return process, line.rpartition(" ")[2].strip()
        print(line, end="")
    sys.exit("rcpd did not serve")


def main() -> int:
    with tempfile.TemporaryDirectory() as home:
        process, url = served(Path(home))
        try:
            kept = asyncio.run(soak(url, psutil.Process(process.pid)))
        finally:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=40)
    middle = statistics.median(kept)
    off = max(abs(one - middle) for one in kept) / middle
    third = len(kept) // 3
    grown = statistics.median(kept[-third:]) - statistics.median(kept[:third])
    flat = off <= FLAT
    print(
        f"after the warm-up: median {middle:.1f} MB, at most {off:.1%} off, last third {grown:+.2f} MB"
    )
    print("flat" if flat else "NOT FLAT")
    return not flat


if __name__ == "__main__":
    sys.exit(main())
