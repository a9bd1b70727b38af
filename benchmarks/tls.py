"""What TLS costs: WebSocket reads and new connections, with and without. Run: python benchmarks/tls.py"""

from __future__ import annotations

import asyncio
import json
import ssl
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import uvloop
from answers import Answers
from measure import SECONDS, best, row
from picows import WSListener, WSMsgType, ws_connect

ASK = b'{"type":"read","id":"c-17","path":"/tenant/t/sensor/pose"}'
CLIENTS = 32
TOOK: list[float] = []


class Asker(WSListener):
    done = 0
    answers = Answers()
    counting = False

    def __init__(self):
        self.sent = 0.0

    def ask(self, transport):
        self.sent = time.perf_counter()
        transport.send(WSMsgType.TEXT, ASK)

    def on_ws_frame(self, transport, frame):
        if not Asker.counting:
            Asker.answers.look(frame.get_payload_as_bytes())
        Asker.done += 1
        TOOK.append(time.perf_counter() - self.sent)
        self.ask(transport)


async def load(port: str, server: str, clients: str) -> None:
    context = None
    if server == "tls":
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    url = f"{'ws' if context is None else 'wss'}://127.0.0.1:{port}/rcp/v1/ws"
    if clients == "new":
        print("ready", flush=True)
        done, end = 0, time.perf_counter() + SECONDS
        while time.perf_counter() < end:
            transport, _ = await ws_connect(Asker, url, ssl_context=context)
            transport.disconnect()
            done += 1
        print(json.dumps({"done": done}), flush=True)
        return
    for _ in range(int(clients)):
        transport, asker = await ws_connect(Asker, url, ssl_context=context)
        asker.ask(transport)
    await asyncio.sleep(0.3)
    Asker.answers.check(Asker.done)
    Asker.counting = True
    TOOK.clear()
    print("ready", flush=True)
    before = Asker.done
    await asyncio.sleep(SECONDS)
    p50 = median(TOOK) * 1e6
    print(json.dumps({"done": Asker.done - before, "p50": p50}), flush=True)


def serve(server: str) -> None:
    from served import serve_gateway

    if server == "plain":
        serve_gateway()
        return
    with tempfile.TemporaryDirectory() as folder:
        cert, key = Path(folder) / "cert.pem", Path(folder) / "key.pem"
        made = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 1"
        call = [*made.split(), "-subj", "/CN=localhost", "-keyout", str(key), "-out", str(cert)]
        subprocess.run(call, check=True, capture_output=True)
        serve_gateway(more=f'tls = {{certificate = "{cert}", key = "{key}"}}')


def main() -> None:
    for clients, name in (("1", "reads of one client"), (str(CLIENTS), f"of {CLIENTS}")):
        plain, tls = best(__file__, ("plain", clients), ("tls", clients))
        row(f"{name}, plain", plain)
        row(f"{name}, TLS", tls, plain)
        print(f"  p50 {plain['p50']:.0f} µs plain, {tls['p50']:.0f} µs TLS")
    plain, tls = best(__file__, ("plain", "new"), ("tls", "new"))
    row("new connections, plain", plain)
    row("new connections, TLS", tls, plain)


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        serve(sys.argv[2])
    elif sys.argv[1:2] == ["load"]:
        uvloop.run(load(*sys.argv[2:5]))
    else:
        main()
