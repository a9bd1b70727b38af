"""Whether a big topic or a stalled client delays a small one: the age of a 50 Hz pose on arrival.

Three runs of one server: the pose alone; with a 10 MB map at 2 Hz on the same connection, in
segments; with that and a client beside it that subscribed to everything and reads nothing.
Run: python benchmarks/starvation.py
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import psutil
import uvloop
from answers import Answers
from picows import WSListener, WSMsgType, ws_connect

SECONDS = 8.0


class Reader(WSListener):
    def __init__(self, *, maps: bool, stalled: bool = False) -> None:
        self.maps, self.stalled = maps, stalled
        self.ages: list[float] = []
        self.bytes = 0
        self.answers = Answers()

    def on_ws_connected(self, transport) -> None:
        def send(**envelope) -> None:
            transport.send(WSMsgType.BINARY, msgspec.msgpack.encode(envelope))

        if not self.stalled:
            send(type="hello", id="h", body={"segment_size": 65536})
        send(type="subscribe", id="p", path="/sensor/pose")
        if self.maps:
            send(type="subscribe", id="m", path="/sensor/blob")
        if self.stalled:
            transport.underlying_transport.pause_reading()

    def on_ws_frame(self, transport, frame) -> None:
        self.bytes += frame.payload_size
        if frame.payload_size > 2000:
            return
        data = frame.get_payload_as_bytes()
        message = msgspec.msgpack.decode(data)
        self.answers.look(data)
        if message.get("type") == "update":
            self.ages.append(time.time_ns() / 1e6 - message["body"]["sent"] / 1e3)


async def measure(port: str, *, maps: bool, stalled: bool) -> dict[str, float]:
    url = f"ws://127.0.0.1:{port}/rcp/v1/ws"
    options = {
        "extra_headers": {"Sec-WebSocket-Protocol": "rcp.v1.msgpack"},
        "max_frame_size": 1 << 26,
    }
    if stalled:
        await ws_connect(lambda: Reader(maps=True, stalled=True), url, **options)
    transport, reader = await ws_connect(lambda: Reader(maps=maps), url, **options)
    await asyncio.sleep(1.0)
    reader.ages.clear()
    reader.bytes = 0
    await asyncio.sleep(SECONDS)
    reader.answers.check(len(reader.ages))
    ages = sorted(reader.ages)
    transport.disconnect()
    return {
        "updates": len(ages),
        "p50_ms": round(ages[len(ages) // 2], 2),
        "p99_ms": round(ages[int(len(ages) * 0.99)], 2),
        "MB/s": round(reader.bytes / SECONDS / 1e6, 1),
    }


async def main() -> None:
    server = Path(__file__).parent / "servers" / "gateway.py"
    for title, size, maps, stalled in (
        ("pose alone", 0, False, False),
        ("with a 10 MB map at 2 Hz", 10_000_000, True, False),
        ("with the map and a stalled client", 10_000_000, True, True),
    ):
        command = [sys.executable, str(server), "50", "1", str(size), "2" if size else "0"]
        with subprocess.Popen(  # noqa: ASYNC220 - nothing else runs in this loop yet
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=server.parent
        ) as process:
            psutil.Process(process.pid).cpu_affinity([0])
            assert process.stdout
            port = process.stdout.readline().decode().strip()
            found = await measure(port, maps=maps, stalled=stalled)
            rss = psutil.Process(process.pid).memory_info().rss / 1e6
            process.terminate()
        print(f"{title:36} {json.dumps(found)}  server {rss:.0f} MB", flush=True)


psutil.Process().cpu_affinity([1])
uvloop.run(main())
