"""Replies per CPU-second of the server for each kind of request, of this tree and of another in turns.

Run: python benchmarks/requests.py [KIND…] [--beside TREE]. `--beside` names another working tree with
a `.venv` of its own, which serves with its own `served.py`. Both serve on one core, and are asked in
turns from another, so that what else the machine does meets both; the ratio is the median of those of
the pairs. 32 clients have one request each in flight; updates come in bursts of 16 to 10 or 100.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import json
import statistics
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

import psutil
import uvloop
from instructions import (
    ASKED,
    CONFIG,
    FOLLOW,
    GOT,
    HANDSHAKE,
    HEADERS,
    STORE,
    Asker,
    Getter,
    execute,
)
from instructions import Subscriber as Subscribing
from measure import SECONDS, cpu_of, line_of
from picows import ws_connect

KINDS = (
    "read",
    "get",
    "write",
    "kept-write",
    "execute",
    "kept-execute",
    "feedback",
    "fan-10",
    "fan-100",
)
CLIENTS = 32
ROUNDS = 7
ENDLESS = 10**9
BURST = 16
OFFERED = 400_000  # deliveries a second
GARBAGE = (2_000, 50_000, 10)
"""Thresholds of the collector, as in `rcpd`."""


class OneAsker(Asker):
    """Keeps one request in flight."""

    def on_ws_connected(self, transport):
        self.ask(transport)

    @property
    def count(self) -> int:
        return ENDLESS - self.left


class OneGetter(Getter):
    """Sends one GET after the other."""

    @property
    def count(self) -> int:
        return ENDLESS - self.left


class Subscriber(Subscribing):
    """Counts updates."""

    count = 0

    def on_ws_frame(self, transport, frame):
        self.count += 1
        if not self.there.is_set():
            super().on_ws_frame(transport, frame)


async def load(port: str, kind: str) -> None:
    """Connect, and print how many operations of a kind were done in a time."""
    url = f"ws://127.0.0.1:{port}/rcp/v1/ws"
    clients = []
    if kind in GOT:
        for _ in range(CLIENTS):
            clients.append(OneGetter(ENDLESS, GOT[kind]))
            await asyncio.get_running_loop().create_connection(
                lambda: clients[-1], "127.0.0.1", int(port)
            )
    elif kind.startswith("fan"):
        for _ in range(int(kind.partition("-")[2])):
            _, subscriber = await ws_connect(
                Subscriber, url, extra_headers=HEADERS, websocket_handshake_timeout=HANDSHAKE
            )
            clients.append(subscriber)
    else:
        asked = ASKED[kind]
        for _ in range(1 if asked is FOLLOW else CLIENTS):  # one action runs only once
            _, asker = await ws_connect(
                lambda: OneAsker(asked, ENDLESS),
                url,
                extra_headers=HEADERS,
                websocket_handshake_timeout=HANDSHAKE,
            )
            clients.append(asker)
    await asyncio.sleep(0.3)
    print("ready", flush=True)
    before = sum(client.count for client in clients)
    await asyncio.sleep(SECONDS)
    print(json.dumps({"done": sum(client.count for client in clients) - before}), flush=True)


async def serve(kind: str) -> None:
    """Serve, with this file's configuration and action; publish if updates are what counts."""
    from served import Bench, gateway, produce

    from rcp_kernel.model import Resource

    Bench.execute = execute  # pyright: ignore[reportAttributeAccessIssue] - of whichever tree
    with tempfile.TemporaryDirectory() as folder:
        config = CONFIG + STORE.format(folder) if kind.startswith("kept") else CONFIG
        async with gateway(config) as (robot, url):
            about = "Counts."
            counts = Resource(
                name="action/count", description=about, input=float, output=float, feedback=float
            )
            robot.host.declare(counts)
            gc.collect()
            gc.freeze()
            gc.set_threshold(*GARBAGE)
            print(url.rpartition(":")[2], flush=True)
            fan, _, number = kind.partition("-")
            rate = OFFERED / int(number) if fan == "fan" else 0.0
            await produce(robot.publish, rate, BURST)


class Server:
    """The gateway of a tree."""

    def __init__(self, tree: Path, kind: str, stack: ExitStack) -> None:
        python = str(tree / ".venv" / "bin" / "python")
        self._kind = kind
        self._process = subprocess.Popen(
            [python, __file__, "serve", kind], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        stack.callback(self._process.wait)
        stack.callback(self._process.kill)
        psutil.Process(self._process.pid).cpu_affinity([0])
        self._port = line_of(self._process).decode().strip()

    def measure(self) -> float:
        """Return the operations of the kind for each CPU-second."""
        command = [sys.executable, __file__, "load", self._port, self._kind]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as client:
            psutil.Process(client.pid).cpu_affinity([1])
            line_of(client)
            before = cpu_of(self._process.pid)
            done = json.loads(line_of(client))["done"]
            return done / (cpu_of(self._process.pid) - before)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=KINDS, metavar="KIND")
    parser.add_argument("--beside", type=Path, metavar="TREE")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    asked = parser.parse_args()
    trees = [Path(__file__).resolve().parents[1]]
    if asked.beside:
        trees.append(asked.beside.resolve())
    for kind in asked.kinds:
        with ExitStack() as stack:
            servers = [Server(tree, kind, stack) for tree in trees]
            rounds = [[server.measure() for server in servers] for _ in range(asked.rounds)]
        here, *there = (statistics.median(found) for found in zip(*rounds, strict=True))
        line = f"  {kind:14} {here / 1000:9.1f} k/CPU-s"
        for other in there:
            ratio = statistics.median(mine / theirs for mine, theirs in rounds)
            line += f"   {other / 1000:9.1f} k there   {ratio:5.2f} x"
        print(line, flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        sys.path[0] = str(Path(sys.prefix).parent / "benchmarks")
        uvloop.run(serve(sys.argv[2]))
    elif sys.argv[1:2] == ["load"]:
        uvloop.run(load(sys.argv[2], sys.argv[3]))
    else:
        main()
