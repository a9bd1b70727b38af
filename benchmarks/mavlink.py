"""What a MAVLink message costs the gateway, beside bare pymavlink that parses the same and no more.

Run: python benchmarks/mavlink.py. Twenty vehicles send 50 messages a second each over UDP. The
gateway keeps each as the latest value, and again with a WebSocket client that is sent every one.
"""

from __future__ import annotations

import asyncio
import json
import math
import subprocess
import sys
import time
from contextlib import asynccontextmanager

import psutil
import uvloop

VEHICLES, RATE, SECONDS = 20, 50, 6.0
LIVE = 4  # kinds of messages, sent in turns
KEY = "operator-of-the-benchmark"
WATCHED = ("attitude", "velocity", "gps", "position/global")


def frames(module, system: int) -> list[bytes]:
    """Pack what one vehicle sends in turns, the heartbeat last."""
    out: list[bytes] = []

    class Out:
        def write(self, frame: bytes) -> None:
            out.append(bytes(frame))

    mav = module.MAVLink(Out(), system, 1)
    for n in range(RATE - 1):
        match n % LIVE:
            case 0:
                mav.send(module.MAVLink_attitude_message(n, math.sin(n), 0.1, 0.2, 0.3, 0.4, 0.5))
            case 1:
                mav.send(module.MAVLink_vfr_hud_message(5.1, 4.9, 90, 50, 584.0 + n, 0.5))
            case 2:
                mav.send(
                    module.MAVLink_gps_raw_int_message(n, 3, -353632621 + n, 1491652374, 584000, 121, 200, 10, 900, 10)
                )  # fmt: skip
            case _:
                mav.send(
                    module.MAVLink_global_position_int_message(n, -353632621 + n, 1491652374, 584000, 10000, 1, 2, 3, 9000)
                )  # fmt: skip
    mav.send(module.MAVLink_heartbeat_message(2, 3, 209, 4, 4, 3))
    return out


class Vehicle(asyncio.DatagramProtocol):
    """Acknowledges every command, and sends when it is told to."""

    def __init__(self, module, system: int) -> None:
        self.module, self.frames = module, frames(module, system)
        self.beat = self.frames[-1]
        self.sent = self.seq = 0
        self.mav = module.MAVLink(self, system, 1)
        self.mav.robust_parsing = True

    def connection_made(self, transport) -> None:
        self.transport = transport

    def write(self, frame: bytes) -> None:
        self.transport.sendto(bytes(frame))

    def datagram_received(self, data: bytes, addr) -> None:
        for message in self.mav.parse_buffer(data) or ():
            if message.get_type() == "COMMAND_LONG":
                ack = self.module.MAVLink_command_ack_message(message.command, 0, 0, 0, 255, 190)
                self.mav.seq = self.seq & 0xFF
                self.mav.send(ack)
                self.seq += 1

    def send(self) -> None:
        # The sender's count goes on from round to round, so that the receiver sees what is lost.
        frame = bytearray(self.frames[self.sent % RATE])
        frame[4] = self.seq & 0xFF
        crc = self.crc(frame)
        frame[-2:] = crc.to_bytes(2, "little")
        self.transport.sendto(frame)
        self.sent += 1
        self.seq += 1

    def crc(self, frame: bytearray) -> int:
        extra = self.module.mavlink_map[int.from_bytes(frame[7:10], "little")].crc_extra
        return self.module.x25crc(frame[1:-2] + bytes((extra,))).crc


async def load(port: int) -> None:
    from pymavlink.dialects.v20 import ardupilotmega

    loop = asyncio.get_running_loop()
    vehicles = []
    for n in range(VEHICLES):
        _, vehicle = await loop.create_datagram_endpoint(
            lambda n=n: Vehicle(ardupilotmega, n + 1), remote_addr=("127.0.0.1", port)
        )
        vehicles.append(vehicle)
    for _ in range(4):
        for vehicle in vehicles:
            vehicle.transport.sendto(vehicle.beat)
        await asyncio.sleep(0.5)
    print("ready", flush=True)
    await loop.run_in_executor(None, sys.stdin.readline)
    begun = loop.time()
    for tick in range(round(SECONDS * RATE)):
        for vehicle in vehicles:
            vehicle.send()
        await asyncio.sleep(max(0.0, begun + (tick + 1) / RATE - loop.time()))
    print(sum(vehicle.sent for vehicle in vehicles), flush=True)
    await loop.run_in_executor(None, sys.stdin.readline)


async def floor() -> None:
    """Parse and count, with pymavlink alone."""
    from pymavlink.dialects.v20 import ardupilotmega

    parsers: dict = {}
    count = [0]

    class Floor(asyncio.DatagramProtocol):
        def datagram_received(self, data: bytes, addr) -> None:
            parser = parsers.get(addr)
            if parser is None:
                parser = parsers[addr] = ardupilotmega.MAVLink(None)
                parser.robust_parsing = True
            count[0] += len(parser.parse_buffer(data) or ())

    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(Floor, local_addr=("127.0.0.1", 0))
    print(json.dumps({"port": transport.get_extra_info("sockname")[1]}), flush=True)
    while await loop.run_in_executor(None, sys.stdin.readline):
        print(json.dumps({"frames": count[0], "lost": 0}), flush=True)


async def gateway() -> None:
    import rcp_mavlink
    from rcp_gateway.log import configure
    from rcp_gateway.testing import serve
    from rcp_kernel.config.file import parse

    configure("error")
    text = f"""
log = {{ level = "error" }}
[transports.asgi]
port = 0
[[backends]]
use = "mavlink"
tenant = "t"
links = ["udpin:127.0.0.1:0"]
discover = true
params = []
connect = 60
[[keys]]
name = "bench"
role = "operator"
key = "{KEY}"
"""
    kind = next(iter(rcp_mavlink.rcp_backends()))
    hubs = []
    from rcp_mavlink import hub as hubs_module

    original = hubs_module.Hub.__init__

    def noted(self, *given) -> None:
        original(self, *given)
        hubs.append(self)

    hubs_module.Hub.__init__ = noted
    loop = asyncio.get_running_loop()
    async with serve(parse(text, "benchmark"), kind) as served, _collecting(loop):
        url = next(f["url"] for f in served.server.status.transports if "url" in f)
        port = hubs[0].links[0].port
        print(json.dumps({"port": port, "url": url}), flush=True)
        while await loop.run_in_executor(None, sys.stdin.readline):
            stats = hubs[0].links[0].framer.stats
            print(json.dumps({"frames": stats.frames, "lost": stats.lost}), flush=True)


@asynccontextmanager
async def _collecting(loop):
    """Collect garbage as `rcpd serve` does."""
    from rcpd.garbage import collected_at_rest

    with collected_at_rest(loop, lambda: False):
        yield


async def watch(url: str) -> None:
    """Subscribe to what all vehicles send, and count what comes."""
    import websockets

    address = url.replace("http", "ws") + "/rcp/v1/ws"
    headers = {"Authorization": f"Bearer {KEY}"}
    async with websockets.connect(address, additional_headers=headers, max_queue=None) as ws:
        body = {
            "paths": [f"/tenant/t/sensor/*/{name}" for name in WATCHED],
            "qos": {"reliability": "reliable", "depth": 4096},
            "initial": False,
        }
        path = body["paths"].pop(0)
        await ws.send(json.dumps({"type": "subscribe", "id": "s", "path": path, "body": body}))
        answer = json.loads(await ws.recv())
        if "error" in answer:
            sys.exit(f"the subscription was refused: {json.dumps(answer)}")
        print(answer["status"], flush=True)
        count, dropped = 0, 0
        try:
            while True:
                async with asyncio.timeout(3.0):
                    message = await ws.recv()
                count += '"update"' in message
                dropped += '"dropped"' in message
        except TimeoutError:
            print(json.dumps({"updates": count, "dropped": dropped}), flush=True)


def start(*words: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, __file__, *words],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
    )  # fmt: skip


def measured(server: str, *, watched: bool) -> dict[str, float]:
    receiver = start(server)
    facts = json.loads(receiver.stdout.readline())
    psutil.Process(receiver.pid).cpu_affinity([0])
    sender = start("load", str(facts["port"]))
    psutil.Process(sender.pid).cpu_affinity([1])
    sender.stdout.readline()
    watcher = start("watch", facts["url"]) if watched else None
    if watcher:
        psutil.Process(watcher.pid).cpu_affinity([1])
        assert watcher.stdout.readline().strip() == "completed"
    time.sleep(2.0)

    def ask() -> dict[str, int]:
        receiver.stdin.write("\n")
        receiver.stdin.flush()
        return json.loads(receiver.stdout.readline())

    before, cpu = ask(), psutil.Process(receiver.pid).cpu_times()
    sender.stdin.write("\n")
    sender.stdin.flush()
    sent = int(sender.stdout.readline())
    time.sleep(0.5)
    after, done = psutil.Process(receiver.pid).cpu_times(), ask()
    found = {
        "sent": sent,
        "received": done["frames"] - before["frames"],
        "lost": done["lost"] - before["lost"],
        "us": 1e6 * (after.user + after.system - cpu.user - cpu.system) / sent,
    }
    if watcher:
        found |= json.loads(watcher.stdout.readline())
    for process in (sender, receiver, watcher):
        if process:
            process.kill()
            process.wait()
    return found


def main() -> None:
    base = measured("floor", watched=False)
    rows = [
        ("bare pymavlink", base),
        ("gateway, latest values", measured("gateway", watched=False)),
        ("gateway, all to a WebSocket", measured("gateway", watched=True)),
    ]
    for name, found in rows:
        more = f"  updates {found['updates']:.0f}" if "updates" in found else ""
        print(
            f"  {name:30} {found['us']:7.1f} us/message  {found['us'] / base['us']:5.2f} x"
            f"  sent {found['sent']:.0f} received {found['received']:.0f} lost {found['lost']:.0f}{more}"
        )


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["load", port]:
            uvloop.run(load(int(port)))
        case ["floor"]:
            uvloop.run(floor())
        case ["gateway"]:
            uvloop.run(gateway())
        case ["watch", url]:
            asyncio.run(watch(url))
        case _:
            main()
