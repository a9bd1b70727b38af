"""Instructions of the server for one request, one update: the same on a busy machine as on a quiet one.

Run: python benchmarks/instructions.py [KIND…] [--beside TREE]. The server runs under valgrind's
cachegrind, which counts instructions and nothing else. Each kind runs with a small and a large number
of operations; the difference, divided, has no start-up in it. `--beside` names another working tree
with a `.venv` of its own, whose figures stand beside. What waits (locks, disks, caches) is not seen.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from subprocess import PIPE

import uvloop
from picows import WSListener, WSMsgType, ws_connect

READ = {"type": "read", "path": "/tenant/t/sensor/pose"}
WRITE = {"type": "write", "path": "/tenant/t/param/speed", "body": 0.5}
EXECUTE = {"type": "execute", "path": "/tenant/t/service/add", "body": 0.5}
ASKED = {"read": READ, "ping": {"type": "ping"}, "write": WRITE, "execute": EXECUTE}
KINDS = ("read", "ping", "get", "write", "execute", "fan-10", "fan-100")
FEW, MANY = 1600, 4800
PAUSE = 0.3  # s between bursts: under valgrind all takes about fifty times as long
IN_FLIGHT = 16
BURST = 16
KEY = "operator-of-the-benchmark"
CONFIG = f"""
[tenants.t]
[[keys]]
name = "bench"
role = "operator"
key = "{KEY}"
"""
HEADERS = {"Authorization": f"Bearer {KEY}"}
COUNT = ["valgrind", "--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file=/dev/null"]
TOTAL = re.compile(r"I +refs: +([\d,]+)")


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
        for _ in range(IN_FLIGHT):
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

    request = (
        f"GET /rcp/v1/context/tenant/t/sensor/pose HTTP/1.1\r\nAuthorization: Bearer {KEY}\r\n"
        "Host: 127.0.0.1\r\n\r\n"
    ).encode()

    def __init__(self, count: int) -> None:
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
    """Do so many operations of the kind, or stay subscribed until the server ends."""
    url = f"ws://127.0.0.1:{port}/rcp/v1/ws"
    name, _, number = kind.partition("-")
    if name == "fan":
        for _ in range(int(number)):
            transport, subscriber = await ws_connect(Subscriber, url, extra_headers=HEADERS)
            await subscriber.there.wait()
        print("subscribed", flush=True)
        await transport.wait_disconnected()
        return
    if name == "get":
        loop = asyncio.get_running_loop()
        _, getter = await loop.create_connection(lambda: Getter(count), "127.0.0.1", int(port))
        await getter.done.wait()
    else:
        _, asker = await ws_connect(lambda: Asker(ASKED[name], count), url, extra_headers=HEADERS)
        await asker.done.wait()


async def serve(kind: str, count: int) -> None:
    """Serve; for a fan-out publish `count` updates in bursts to as many as subscribed, and end."""
    from served import gateway

    async with gateway(CONFIG) as (robot, url):
        print(url.rpartition(":")[2], flush=True)
        if not kind.startswith("fan"):
            await asyncio.Event().wait()
        await asyncio.to_thread(sys.stdin.readline)
        for _ in range(count // BURST):
            for _ in range(BURST):
                robot.publish()
            await asyncio.sleep(PAUSE)
        os.kill(os.getpid(), signal.SIGTERM)


def counted(tree: Path, kind: str, count: int) -> int:
    """Instructions of a server's whole life in which it did so much."""
    environment = {
        **os.environ,
        "PYTHONHASHSEED": "0",
        "PYTHONPATH": str(tree / "benchmarks"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    serving = [*COUNT, str(tree / ".venv" / "bin" / "python"), __file__, "serve", kind, str(count)]
    with tempfile.TemporaryFile("w+") as said:
        server = subprocess.Popen(
            serving, stdin=PIPE, stdout=PIPE, stderr=said, env=environment, text=True
        )
        assert server.stdin
        assert server.stdout
        port = server.stdout.readline().strip()
        loading = [sys.executable, __file__, "load", port, kind, str(count)]
        client = subprocess.Popen(loading, stdout=PIPE, text=True)
        assert client.stdout
        if client.stdout.readline():
            server.stdin.write("publish\n")
            server.stdin.flush()
            server.wait()
        result = client.wait()
        server.terminate()
        server.wait()
        said.seek(0)
        text = said.read()
    if result or not (found := TOTAL.search(text)):
        raise SystemExit(f"{kind}: not measured\n{text}")
    return int(found[1].replace(",", ""))


def each(tree: Path, kind: str) -> float:
    """Instructions for one operation."""
    few, many = (FEW // 4, MANY // 4) if kind.startswith("fan") else (FEW, MANY)
    return (counted(tree, kind, many) - counted(tree, kind, few)) / (many - few)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=KINDS, metavar="KIND")
    parser.add_argument("--beside", type=Path, metavar="TREE")
    asked = parser.parse_args()
    here = Path(__file__).resolve().parents[1]
    for kind in asked.kinds or KINDS:
        mine = each(here, kind)
        beside = ""
        if asked.beside:
            other = each(asked.beside.resolve(), kind)
            beside = f"   {other / 1000:9.1f} k there   {mine / other:5.3f} x"
        print(f"  {kind:10} {mine / 1000:9.1f} k instructions{beside}", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        uvloop.run(serve(sys.argv[2], int(sys.argv[3])))
    elif sys.argv[1:2] == ["load"]:
        uvloop.run(load(sys.argv[2], sys.argv[3], int(sys.argv[4])))
    else:
        main()
