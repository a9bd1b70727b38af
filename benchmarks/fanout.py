"""Updates of about 300 B over WebSocket to 10 and 100 subscribers. Run: python benchmarks/fanout.py

Beside it a bare picows server that joins the frames of a burst and knows nothing of robots.
"""

from __future__ import annotations

import asyncio
import json
import sys

import uvloop
from answers import Answers
from measure import SECONDS, best, row
from picows import WSListener, WSMsgType, ws_connect, ws_create_server

BURST = 16
FLOOR = 1_000_000
OFFERED = 400_000  # deliveries a second
UPDATE = b"u" * 300


class Bare(WSListener):
    clients: list = []  # noqa: RUF012 - of the one server in this process

    def on_ws_connected(self, transport):
        Bare.clients.append(transport.underlying_transport)


async def bare(clients: int) -> None:
    from served import produce

    server = await ws_create_server(lambda _: Bare(), "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    frame = b"\x81\x7e" + len(UPDATE).to_bytes(2, "big") + UPDATE

    def publish() -> None:
        for transport in Bare.clients:
            if not transport.is_closing():
                transport.write(b"".join([frame] * BURST))

    await produce(publish, OFFERED / clients / BURST, 1)


class Subscriber(WSListener):
    done = 0
    count = 0
    answers = Answers()
    counting = False

    def on_ws_connected(self, transport):
        Subscriber.count += 1
        ask = {
            "type": "subscribe",
            "id": f"{Subscriber.prefix}{Subscriber.count if Subscriber.own else 0:04}",
            "path": "/tenant/t/sensor/pose",
            "body": {"qos": {"depth": 4 * BURST}},
        }
        transport.send(WSMsgType.TEXT, json.dumps(ask).encode())

    def on_ws_frame(self, transport, frame):
        if not Subscriber.counting:
            Subscriber.answers.look(frame.get_payload_as_bytes())
        Subscriber.done += 1
        Subscriber.size = frame.payload_size


async def load(port: str, server: str, clients: str) -> None:
    Subscriber.own = server.startswith("gateway-own")
    Subscriber.prefix = "pose-"
    for _ in range(int(clients)):
        await ws_connect(Subscriber, f"ws://127.0.0.1:{port}/rcp/v1/ws")
    await asyncio.sleep(0.5)
    Subscriber.answers.check(Subscriber.done)
    print("ready", flush=True)
    Subscriber.counting = True
    before = Subscriber.done
    await asyncio.sleep(SECONDS)
    done = Subscriber.done - before
    Subscriber.answers.check(done)
    print(json.dumps({"done": done, "size": Subscriber.size}), flush=True)


def main() -> None:
    for clients in (10, 100):
        base, alike, own = best(
            __file__,
            (f"bare-{clients}", str(clients)),
            (f"gateway-alike-{clients}", str(clients)),
            (f"gateway-own-{clients}", str(clients)),
        )
        row(f"{clients}: bare picows, joined", base)
        row(f"{clients}: gateway, one id ({alike['size']:.0f} B)", alike, base)
        row(f"{clients}: gateway, own ids ({own['size']:.0f} B)", own, base)
    print(f"  floor {FLOOR / 1000:.0f} k/CPU-s")


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        kind, _, number = sys.argv[2].rpartition("-")
        if kind == "bare":
            uvloop.run(bare(int(number)))
        else:
            from served import serve_gateway

            serve_gateway(OFFERED / int(number), BURST)
    elif sys.argv[1:2] == ["load"]:
        uvloop.run(load(*sys.argv[2:5]))
    else:
        main()
