"""Instructions of the server for one request, one update: the same on a busy machine as on a quiet one.

Run: python benchmarks/instructions.py [KIND…] [--beside TREE]. The server runs under valgrind's
callgrind, which counts instructions and nothing else. Each kind runs with a small and a large number
of operations; the difference, divided, has no connecting and no warming up in it. `--beside` names
another working tree with a `.venv` of its own, which serves with its own `served.py`; its figures
stand beside. What waits (locks, disks, caches) and the operating system's share are not seen.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import itertools
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from subprocess import DEVNULL, PIPE

import uvloop
from picows import WSListener, WSMsgType, ws_connect

READ = {"type": "read", "path": "/tenant/t/sensor/pose"}
WRITE = {"type": "write", "deadline": 300, "path": "/tenant/t/param/speed", "body": 0.5}
EXECUTE = {"type": "execute", "deadline": 300, "path": "/tenant/t/service/add", "body": 0.5}
FOLLOW = {"type": "execute", "deadline": 300, "path": "/tenant/t/action/count", "body": 0.5}
ASKED = {
    "read": READ,
    "ping": {"type": "ping"},
    "write": WRITE,
    "kept-write": WRITE,
    "execute": EXECUTE,
    "feedback": FOLLOW,
    "kept-execute": EXECUTE,
}
KINDS = (*ASKED, "get", "anonymous-get", "fan-1", "fan-10", "fan-100")
WARM, FEW, MANY = 160, 320, 1280
TURNS = 8  # of the loop between bursts; to sleep would count what the gateway does meanwhile
ROUNDS = 3  # of which the median counts: a collection of garbage falls into one of them
IN_FLIGHT = 16
HANDSHAKE = 60.0  # s: a server under callgrind on a busy machine
BURST = 16
KEY = "operator-of-the-benchmark"
CONFIG = f"""
[tenants.t]
[[keys]]
name = "bench"
role = "operator"
key = "{KEY}"
"""
STORE = '[store]\npath = "{}/store.db"\n'
HEADERS = {"Authorization": f"Bearer {KEY}"}
GOT: dict[str, dict[str, str]] = {"get": HEADERS, "anonymous-get": {}}
COUNT = ["valgrind", "--tool=callgrind", "--dump-before=getsid"]
"""Counts from one call of `getsid`, which nothing else calls, to the next."""
TOTAL = re.compile(r"^totals: (\d+)", re.MULTILINE)


class Asker(WSListener):
    """Keeps requests in flight until so many were answered."""

    def __init__(self, asked: dict[str, object], count: int) -> None:
        self.asked = asked
        self.left = count
        self.numbers = itertools.count()
        self.done = asyncio.Event()

    def ask(self, transport) -> None:
        id_ = f"c-{next(self.numbers)}"
        transport.send(WSMsgType.TEXT, json.dumps({"id": id_, **self.asked}).encode())

    def on_ws_connected(self, transport):
        for _ in range(1 if self.asked is FOLLOW else IN_FLIGHT):  # one action runs only once
            self.ask(transport)

    def on_ws_frame(self, transport, frame):
        data = frame.get_payload_as_bytes()
        if b'"error"' in data:
            raise SystemExit(data.decode())
        if b'"completed"' in data:
            self.left -= 1
            if self.left > 0:
                self.ask(transport)
            elif self.left == 0:
                self.done.set()


class Getter(asyncio.Protocol):
    """Sends one GET after the other."""

    def __init__(self, count: int, headers: dict[str, str]) -> None:
        lines = [f"{name}: {value}\r\n" for name, value in headers.items()]
        self.request = (
            "GET /rcp/v1/context/tenant/t/sensor/pose HTTP/1.1\r\nHost: 127.0.0.1\r\n"
            f"{''.join(lines)}\r\n"
        ).encode()
        self.left = count
        self.answer = b""
        self.done = asyncio.Event()
        self.transport: asyncio.WriteTransport

    def connection_made(self, transport):
        self.transport = transport
        transport.write(self.request)

    def data_received(self, data):
        self.answer += data  # head and body may come apart
        if not self.answer.startswith(b"HTTP/1.1 200"):
            raise SystemExit(self.answer.decode())
        if not self.answer.endswith(b"}"):
            return
        self.answer = b""
        self.left -= 1
        if self.left:
            self.transport.write(self.request)
        else:
            self.done.set()


class Subscriber(WSListener):
    def __init__(self) -> None:
        self.there = asyncio.Event()

    def on_ws_connected(self, transport):
        body = {"qos": {"depth": 4 * BURST}}
        ask = {"type": "subscribe", "id": "s", "path": "/tenant/t/sensor/pose", "body": body}
        transport.send(WSMsgType.TEXT, json.dumps(ask).encode())

    def on_ws_frame(self, _transport, frame):
        if not self.there.is_set():
            data = frame.get_payload_as_bytes()
            if b'"completed"' not in data:
                raise SystemExit(data.decode())
            self.there.set()


async def load(port: str, kind: str, count: int) -> None:
    """Do so many operations of the kind, or stay subscribed until killed."""
    url = f"ws://127.0.0.1:{port}/rcp/v1/ws"
    name, _, number = kind.partition("-")
    if name == "fan":
        for _ in range(int(number)):
            transport, subscriber = await ws_connect(
                Subscriber, url, extra_headers=HEADERS, websocket_handshake_timeout=HANDSHAKE
            )
            await subscriber.there.wait()
        print("subscribed", flush=True)
        await transport.wait_disconnected()
        return
    if kind in GOT:
        loop = asyncio.get_running_loop()
        getter = Getter(count, GOT[kind])
        await loop.create_connection(lambda: getter, "127.0.0.1", int(port))
        await getter.done.wait()
    else:
        _, asker = await ws_connect(
            lambda: Asker(ASKED[kind], count),
            url,
            extra_headers=HEADERS,
            websocket_handshake_timeout=HANDSHAKE,
        )
        await asker.done.wait()


async def serve(*, store: bool) -> None:
    """Serve, publish as many updates as a line of the input says, and mark where counts end.

    The gateway leaves to the next turn of its loop what a turn has no time for. Here all takes fifty
    times as long and would be left more often than it is, so these clocks stand still. What comes
    once in so many seconds, whatever is done meanwhile, must not count: the full collections.
    """
    gc.collect = lambda *_: 0
    time.thread_time = time.perf_counter = itertools.repeat(1.0).__next__
    from served import Bench, gateway

    Bench.execute = execute  # pyright: ignore[reportAttributeAccessIssue] - of whichever tree
    with tempfile.TemporaryDirectory() as folder:
        config = CONFIG + STORE.format(folder) if store else CONFIG
        async with gateway(config) as (robot, url):
            from rcp_kernel.model import Resource

            about = Resource(
                name="action/count",
                description="Counts.",
                input=float,
                output=float,
                feedback=float,
            )
            robot.host.declare(about)
            print(url.rpartition(":")[2], flush=True)
            while line := await asyncio.to_thread(sys.stdin.readline):
                for _ in range(int(line) // BURST):
                    for _ in range(BURST):
                        robot.publish()
                    for _ in range(TURNS):
                        await asyncio.sleep(0)
                os.getsid(0)
                print("marked", flush=True)


async def execute(_robot: object, name: str, value: float, progress) -> float:
    """Add one; the action tells twice how far it is."""
    if name == "action/count":
        progress(value)
        progress(value, fraction=0.5)
    return value + 1.0


class Server:
    """The gateway of a tree, under callgrind."""

    def __init__(self, tree: Path, *, store: bool) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self._marks = 0
        environment = {**os.environ, "PYTHONHASHSEED": "0"}
        out = f"--callgrind-out-file={self._folder.name}/count"
        serving = [str(tree / ".venv" / "bin" / "python"), __file__, "serve", str(tree), str(store)]
        self._process = subprocess.Popen(
            [*COUNT, out, *serving],
            stdin=PIPE,
            stdout=PIPE,
            stderr=DEVNULL,
            env=environment,
            text=True,
        )
        self._port = self._line()

    def _line(self) -> str:
        assert self._process.stdout
        if not (line := self._process.stdout.readline()):
            raise SystemExit("the server has ended")
        return line.strip()

    def mark(self, updates: int = 0) -> int:
        """Have so many updates published; return how many instructions were counted since the last mark."""
        assert self._process.stdin
        self._process.stdin.write(f"{updates}\n")
        self._process.stdin.flush()
        self._line()
        self._marks += 1
        return int(TOTAL.findall(Path(self._folder.name, f"count.{self._marks}").read_text())[0])

    def each(self, kind: str) -> float:
        """Instructions for one operation."""
        loading = [sys.executable, __file__, "load", self._port, kind]
        if not kind.startswith("fan"):
            return self._slope(lambda count: subprocess.run([*loading, str(count)], check=True))
        with subprocess.Popen([*loading, "0"], stdout=PIPE) as client:
            assert client.stdout
            client.stdout.readline()
            found = self._slope(None)
            client.kill()
        return found

    def _slope(self, load: Callable[[int], object] | None) -> float:
        self._count(WARM, load)
        rounds = [self._count(MANY, load) - self._count(FEW, load) for _ in range(ROUNDS)]
        return statistics.median(rounds) / (MANY - FEW)

    def _count(self, count: int, load: Callable[[int], object] | None) -> int:
        """Count while so many operations are done, or updates published where nobody has to ask."""
        self.mark()
        if load is None:
            return self.mark(count)
        load(count)
        return self.mark()

    def end(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.communicate()
        self._folder.cleanup()


def measured(tree: Path, kinds: list[str]) -> dict[str, float]:
    """Measure each kind at a tree: those that are kept at a gateway with a store."""
    found: dict[str, float] = {}
    for store in (False, True):
        chosen = [kind for kind in kinds if kind.startswith("kept") is store]
        if chosen:
            server = Server(tree, store=store)
            found |= {kind: server.each(kind) for kind in chosen}
            server.end()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=KINDS, metavar="KIND")
    parser.add_argument("--beside", type=Path, metavar="TREE")
    asked = parser.parse_args()
    trees = [Path(__file__).resolve().parents[1]]
    if asked.beside:
        trees.append(asked.beside.resolve())
    with ThreadPoolExecutor() as threads:
        here, *there = threads.map(measured, trees, itertools.repeat(list(asked.kinds)))
    for kind, mine in here.items():
        line = f"  {kind:14} {mine / 1000:9.1f} k instructions"
        for other in there:
            line += f"   {other[kind] / 1000:9.1f} k there   {mine / other[kind]:5.3f} x"
        print(line)


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        sys.path[0] = f"{sys.argv[2]}/benchmarks"
        uvloop.run(serve(store=sys.argv[3] == "True"))
    elif sys.argv[1:2] == ["load"]:
        uvloop.run(load(sys.argv[2], sys.argv[3], int(sys.argv[4])))
    else:
        main()
