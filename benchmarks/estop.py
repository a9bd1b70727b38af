"""How soon an e-stop reaches `Backend.halt` with every queue full, over a real WebSocket.

Beside the one who stops there are clients that subscribed to everything reliably and read nothing,
actions that run and queues of commands behind them, and clients that send writes as fast as the
gateway reads them. Measured from before the e-stop is sent to the backend's `halt` being entered.
Run: python benchmarks/estop.py
"""

from __future__ import annotations

import asyncio
import gc
import os
import subprocess
import sys
import time
from math import ceil
from pathlib import Path

import msgspec
import psutil
import uvloop
from picows import WSListener, WSMsgType, ws_connect

STOPS = 100
STALLED, FLOODS = 20, 4
UNANSWERED = 4000  # writes of each of them
ACTIONS, WAITING = 20, 16
WRITE = {"type": "write", "path": "/actuator/drive", "body": {"linear": {"x": 0.5}}}


class Client(WSListener):
    """Sends, counts final replies, and gives those back that are waited for."""

    def __init__(self) -> None:
        self.waited: dict[str, asyncio.Future[dict]] = {}
        self.finals = 0

    def on_ws_connected(self, transport) -> None:
        self.transport = transport

    def send(self, **envelope) -> None:
        self.transport.send(WSMsgType.BINARY, msgspec.msgpack.encode(envelope))

    def ask(self, **envelope) -> asyncio.Future[dict]:
        id_ = envelope["id"]
        self.waited[id_] = asyncio.get_running_loop().create_future()
        self.send(**envelope)
        return self.waited[id_]

    def on_ws_frame(self, transport, frame) -> None:
        message = msgspec.msgpack.decode(frame.get_payload_as_bytes())
        if message.get("status") not in (None, "accepted", "pending", "in_progress"):
            self.finals += 1
            waiter = self.waited.pop(message.get("id"), None)
            if waiter is not None:
                waiter.set_result(message)


async def connected(port: str) -> Client:
    headers = {
        "Sec-WebSocket-Protocol": "rcp.v1.msgpack",
        "Authorization": "Bearer admin-of-the-benchmark",
    }
    url = f"ws://127.0.0.1:{port}/rcp/v1/ws"
    return (await ws_connect(Client, url, extra_headers=headers))[1]


async def flood(port: str) -> None:
    """Send writes from several clients, as many as the gateway reads."""
    os.nice(5)  # the client that measures is on the same core, and is not what is measured
    clients = [await connected(port) for _ in range(FLOODS)]
    print("flooding", flush=True)
    sent = dict.fromkeys(clients, 0)
    while True:
        for client in clients:
            while sent[client] - client.finals < UNANSWERED:
                sent[client] += 1
                client.send(**WRITE)
        await asyncio.sleep(0.001)


async def stop_again_and_again(port: str, halted) -> tuple[list[float], int]:
    """Return how long each e-stop took to the robot, in ms, and how many commands each ended."""
    stalled = [await connected(port) for _ in range(STALLED)]
    for client in stalled:
        qos = {"reliability": "reliable", "depth": 10_000}
        client.send(type="subscribe", id="all", path="/sensor/*", body={"qos": qos})
        client.transport.underlying_transport.pause_reading()
    driver, stopper = await connected(port), await connected(port)
    took: list[float] = []
    for number in range(STOPS):
        for action in range(ACTIONS):
            for place in range(WAITING):
                id_ = f"{number}-{action}-{place}"
                driver.send(type="execute", id=id_, path=f"/action/a{action}")
        await driver.ask(type="ping", id=f"ping-{number}")
        await asyncio.sleep(0.05)
        before = time.monotonic_ns()
        answer = stopper.ask(type="execute", id=f"stop-{number}", path="/system/estop", body={})
        await answer
        moment = 0
        while moment < before:  # the robot is halted once more after what ran has ended
            moment = int(await asyncio.to_thread(halted.readline))
        took.append((moment - before) / 1e6)
        reset = {"reset": True}
        await stopper.ask(type="execute", id=f"reset-{number}", path="/system/estop", body=reset)
    return took, driver.finals // STOPS


async def main() -> None:
    script = Path(__file__).parent / "servers" / "stopped.py"
    with subprocess.Popen(  # noqa: ASYNC220 - nothing else runs in this loop yet
        [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as server:
        psutil.Process(server.pid).cpu_affinity([0])
        assert server.stdout
        port = server.stdout.readline().decode().strip()
        for title in ("in peace", "with writes flooding"):
            flooding = None
            if title != "in peace":
                flooding = subprocess.Popen(  # noqa: ASYNC220
                    [sys.executable, __file__, "flood", port], stdout=subprocess.PIPE
                )
                psutil.Process(flooding.pid).cpu_affinity([1])
                assert flooding.stdout
                await asyncio.to_thread(flooding.stdout.readline)
            took, ended = await stop_again_and_again(port, server.stdout)
            took.sort()
            figures = f"p50 {took[len(took) // 2]:.2f}  p99 {took[ceil(len(took) * 0.99) - 1]:.2f}"
            print(f"{title:24} {figures}  max {took[-1]:.2f} ms, {ended} commands ended each time")
            if flooding is not None:
                flooding.kill()
        server.kill()


if sys.argv[1:2] == ["flood"]:
    uvloop.run(flood(sys.argv[2]))
else:
    psutil.Process().cpu_affinity([1])
    gc.disable()  # the gateway's time is measured, not this process's
    uvloop.run(main())
