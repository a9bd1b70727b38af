"""Replies per CPU-second of the server for each kind of request, of this tree and of another in turns.

Run: python benchmarks/requests.py [KIND…] [--beside TREE]. `--beside` names another working tree with
a `.venv` of its own, which serves with its own `served.py`. The trees alternate, so that what else the
machine does meets both; the ratio is the median of those of the pairs. 32 clients have one request
each in flight; updates come in bursts of 16 to 10 or 100 clients.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import json
import statistics
import sys
import tempfile
from pathlib import Path

import uvloop
from instructions import ASKED, CONFIG, FOLLOW, GOT, HEADERS, STORE, Asker, Getter, execute
from instructions import Subscriber as Subscribing
from measure import SECONDS, measured
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
            _, subscriber = await ws_connect(Subscriber, url, extra_headers=HEADERS)
            clients.append(subscriber)
    else:
        asked = ASKED[kind]
        for _ in range(1 if asked is FOLLOW else CLIENTS):  # one action runs only once
            _, asker = await ws_connect(
                lambda: OneAsker(asked, ENDLESS), url, extra_headers=HEADERS
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=KINDS, metavar="KIND")
    parser.add_argument("--beside", type=Path, metavar="TREE")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    asked = parser.parse_args()
    trees = [Path(__file__).resolve().parents[1]]
    if asked.beside:
        trees.append(asked.beside.resolve())
    pythons = [str(tree / ".venv" / "bin" / "python") for tree in trees]
    for kind in asked.kinds:
        rounds = [
            [measured(__file__, kind, python=python)["per_cpu"] for python in pythons]
            for _ in range(asked.rounds)
        ]
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
