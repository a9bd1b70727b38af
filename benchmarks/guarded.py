"""What rules, quotas, audit and a store cost: the same loads on a gateway with and without them.

Run: python benchmarks/guarded.py [ROUNDS] [KIND…]. Three gateways stand side by side, of which two
are stopped while one is measured; each round measures all, one after the other. A ratio is of two
neighbours in a round; what is printed is the median over the rounds, with the least and the most.
"""

from __future__ import annotations

import asyncio
import json
import signal
import statistics
import subprocess
import sys
import tempfile
import time

import psutil
import uvloop
from answers import Answers
from picows import WSListener, WSMsgType, ws_connect

SECONDS = 1.0
KEY = "operator-of-the-benchmark"
HEADERS = {"Authorization": f"Bearer {KEY}"}
BURST = 16
OFFERED = 400_000  # deliveries a second
WORST = 0.9
POSE = '{"type":"read","id":"c-17","path":"/tenant/t/sensor/pose"}'
WRITE = '{"type":"write","id":"%s","path":"/tenant/t/param/speed","body":0.5}'
EXECUTE = '{"type":"execute","id":"%s","path":"/tenant/t/service/add","body":0.5}'
KINDS = {
    "read": "WebSocket read, 32 clients",
    "ping": "WebSocket ping, 32 clients",
    "get": "HTTP GET, 32 clients",
    "fan-10": "fan-out to 10",
    "fan-100": "fan-out to 100",
    "write-1": "write, 1 in flight",
    "write-100": "write, 100 in flight",
    "execute-1": "execute, 1 in flight",
    "execute-100": "execute, 100 in flight",
}
PLAIN = f"""
[tenants.t]
[[keys]]
name = "bench"
role = "operator"
key = "{KEY}"
"""


def guarded() -> str:
    """Write thirty roles of several rules each, quotas, an envelope and conditions elsewhere."""
    roles = "".join(
        f"""
[roles.r{n}]
allow = [
    {{ operations = ["read", "subscribe"], paths = ["/sensor/**", "/event/**"] }},
    {{ operations = ["*"], paths = ["/param/*", "/service/*"] }},
    {{ operations = ["write"], paths = ["/actuator/a{n}/**"], when = "sensor.battery > 0.2" }},
    {{ operations = ["execute"], paths = ["/action/*"], when = "time.hour > 6" }},
]
deny = [
    {{ operations = ["*"], paths = ["/sensor/secret{n}/**", "/param/**/hidden"] }},
    {{ operations = ["write"], paths = ["/actuator/b{n}"], when = "mode == 'manual'" }},
]
quota = {{ requests = 1_000_000, sessions = 1000, subscriptions = 10_000, commands = 1000, queue_bytes = 1_000_000_000 }}
"""
        for n in range(30)
    )
    held = json.dumps([f"r{n}" for n in range(30)])
    return f"""
[tenants.t.quota]
requests = 1_000_000
sessions = 1000
subscriptions = 10_000
commands = 1000
queue_bytes = 1_000_000_000
[[keys]]
name = "bench"
roles = {{ t = {held} }}
key = "{KEY}"
[[envelopes]]
name = "speed"
paths = ["/param/speed"]
bounds = {{ "" = {{ max = 1.0 }} }}
{roles}"""


def config(server: str) -> str:
    if server == "plain":
        return PLAIN
    store = f'[store]\npath = "{tempfile.mkdtemp(prefix="rcp-bench-")}/store.db"\n'
    return (PLAIN if server == "stored" else guarded()) + store


# -- loads -----------------------------------------------------------------------------------------


class Load:
    done = 0
    since: dict[bytes, float] = {}  # noqa: RUF012 - of the one load in this process
    took: list[float] = []  # noqa: RUF012
    count = 0
    answers = Answers()
    counting = False


class Asker(WSListener):
    request = b""

    def on_ws_frame(self, transport, frame):
        if not Load.counting:
            Load.answers.look(frame.get_payload_as_bytes())
        Load.done += 1
        transport.send(WSMsgType.TEXT, self.request)


class Many(WSListener):
    """Keeps a number of writes or executes in flight on one connection."""

    text = ""

    def ask(self, transport) -> None:
        Load.count += 1
        id_ = f"c-{Load.count}"
        Load.since[id_.encode()] = time.perf_counter()
        transport.send(WSMsgType.TEXT, (self.text % id_).encode())

    def on_ws_frame(self, transport, frame):
        data = frame.get_payload_as_bytes()
        if b'"status":"completed"' in data:
            id_ = data.partition(b'"id":"')[2].partition(b'"')[0]
            Load.took.append(time.perf_counter() - Load.since.pop(id_))
            Load.done += 1
            self.ask(transport)
        else:
            Load.answers.look(data)


class Subscriber(WSListener):
    def on_ws_connected(self, transport):
        body = {"qos": {"depth": 4 * BURST}}
        ask = {"type": "subscribe", "id": "s", "path": "/tenant/t/sensor/pose", "body": body}
        transport.send(WSMsgType.TEXT, json.dumps(ask).encode())

    def on_ws_frame(self, _transport, frame):
        if not Load.counting:
            Load.answers.look(frame.get_payload_as_bytes())
        Load.done += 1


async def load(port: str, kind: str) -> None:
    url = f"ws://127.0.0.1:{port}/rcp/v1/ws"
    name, _, number = kind.partition("-")
    if name == "get":
        from http_get import Getter

        Getter.request = Getter.request.replace(
            b"\r\nHost", f"\r\nAuthorization: Bearer {KEY}\r\nHost".encode()
        )
        loop = asyncio.get_running_loop()
        for _ in range(32):
            await loop.create_connection(Getter, "127.0.0.1", int(port))
    elif name == "fan":
        for _ in range(int(number)):
            await ws_connect(Subscriber, url, extra_headers=HEADERS)
    elif name in ("read", "ping"):
        Asker.request = POSE.encode() if name == "read" else b'{"type":"ping","id":"c-17"}'
        for _ in range(32):
            transport, _ = await ws_connect(Asker, url, extra_headers=HEADERS)
            transport.send(WSMsgType.TEXT, Asker.request)
    else:
        Many.text = WRITE if name == "write" else EXECUTE
        transport, listener = await ws_connect(Many, url, extra_headers=HEADERS)
        for _ in range(int(number)):
            listener.ask(transport)
    await asyncio.sleep(0.4)

    def done() -> int:
        return Getter.done if name == "get" else Load.done

    print("ready", flush=True)
    Load.counting = True
    before, begun = done(), time.perf_counter()
    Load.took.clear()
    await asyncio.sleep(SECONDS)
    (Getter if name == "get" else Load).answers.check(done() - before)
    took = sorted(Load.took) or [0.0]
    result = {
        "done": done() - before,
        "rate": (done() - before) / (time.perf_counter() - begun),
        "p50_ms": took[len(took) // 2] * 1e3,
    }
    print(json.dumps(result), flush=True)


# -- measuring -------------------------------------------------------------------------------------


class Served:
    """A gateway on core 0, stopped but while it is measured."""

    def __init__(self, server: str, kind: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, __file__, "serve", server, kind], stdout=subprocess.PIPE
        )
        psutil.Process(self.process.pid).cpu_affinity([0])
        assert self.process.stdout
        self.port = self.process.stdout.readline().decode().strip()
        self.process.send_signal(signal.SIGSTOP)

    def measure(self, kind: str) -> dict[str, float]:
        self.process.send_signal(signal.SIGCONT)
        info = psutil.Process(self.process.pid)
        with subprocess.Popen(
            [sys.executable, __file__, "load", self.port, kind], stdout=subprocess.PIPE
        ) as client:
            psutil.Process(client.pid).cpu_affinity([1])
            assert client.stdout
            client.stdout.readline()
            before = info.cpu_times()
            result = json.loads(client.stdout.readline())
            after = info.cpu_times()
        time.sleep(0.1)  # for the gateway to see its clients leave
        self.process.send_signal(signal.SIGSTOP)
        cpu = after.user + after.system - before.user - before.system
        return {**result, "per_cpu": result["done"] / cpu}

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


def compare(kind: str, rounds: int) -> None:
    servers = {name: Served(name, kind) for name in ("plain", "stored", "guarded")}
    found: dict[str, list[dict[str, float]]] = {name: [] for name in servers}
    try:
        for turn in range(rounds):
            names = list(servers) if turn % 2 else list(reversed(servers))
            for name in names:
                found[name].append(servers[name].measure(kind))
    finally:
        for served in servers.values():
            served.end()

    def middle(name: str, what: str) -> float:
        return statistics.median(one[what] for one in found[name])

    line = f"  {KINDS[kind]:28}" + "".join(
        f" {middle(name, 'per_cpu') / 1000:8.1f}" for name in servers
    )
    for base in ("plain", "stored"):
        ratios = [
            ours["per_cpu"] / theirs["per_cpu"]
            for ours, theirs in zip(found["guarded"], found[base], strict=True)
        ]
        line += f"   {statistics.median(ratios):5.2f} ({min(ratios):.2f}-{max(ratios):.2f})"
    if middle("plain", "p50_ms"):
        for name in ("plain", "guarded"):
            line += f"   {middle(name, 'rate'):7.0f}/s {middle(name, 'p50_ms'):6.2f} ms"
    print(line, flush=True)


def main(rounds: str = "5", *kinds: str) -> None:
    print("  k/CPU-s                         plain   stored  guarded   guarded/plain      /stored")
    for kind in kinds or KINDS:
        compare(kind, int(rounds))
    print(f"  wanted: reads, GETs, fan-out at least {WORST} of plain")


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        from served import serve_gateway

        name, _, number = sys.argv[3].partition("-")
        rate = OFFERED / int(number) if name == "fan" else 0.0
        serve_gateway(rate, BURST, config(sys.argv[2]))
    elif sys.argv[1:2] == ["load"]:
        uvloop.run(load(*sys.argv[2:4]))
    else:
        main(*sys.argv[1:])
