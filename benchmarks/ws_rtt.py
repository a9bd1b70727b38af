"""WebSocket request and reply beside a bare echo on the same framing. Run: python benchmarks/ws_rtt.py"""

from __future__ import annotations

import asyncio
import json
import sys

import uvloop
from answers import Answers
from measure import SECONDS, best, row
from picows import WSListener, WSMsgType, ws_connect, ws_create_server

CLIENTS = 32
ECHO = b'{"type":"read","id":"c-17","path":"/tenant/t/sensor/pose"}'
FLOOR = 0.6


class Echo(WSListener):
    def on_ws_frame(self, transport, frame):
        if frame.msg_type == WSMsgType.TEXT:
            # As long as the gateway's answer, so that both write the same.
            transport.send(WSMsgType.TEXT, REPLY)


REPLY = b"x" * 345


class Asker(WSListener):
    done = 0
    request = ECHO
    answers = Answers()
    counting = False

    def on_ws_frame(self, transport, frame):
        if not Asker.counting:
            Asker.answers.look(frame.get_payload_as_bytes())
        Asker.done += 1
        Asker.size = frame.payload_size
        transport.send(WSMsgType.TEXT, self.request)


async def load(port: str, server: str, request: str) -> None:
    path = "/rcp/v1/ws" if server == "gateway" else "/"
    Asker.request = request.encode()
    for _ in range(CLIENTS):
        transport, _ = await ws_connect(Asker, f"ws://127.0.0.1:{port}{path}")
        transport.send(WSMsgType.TEXT, Asker.request)
    await asyncio.sleep(0.3)
    Asker.answers.check(Asker.done)
    print("ready", flush=True)
    Asker.counting = True
    before = Asker.done
    await asyncio.sleep(SECONDS)
    Asker.answers.check(Asker.done - before)
    print(json.dumps({"done": Asker.done - before, "size": Asker.size}), flush=True)


async def echo() -> None:
    server = await ws_create_server(lambda _: Echo(), "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await server.serve_forever()


def main() -> None:
    asked, ping = ECHO.decode(), '{"type":"ping","id":"c-17"}'
    base, read, pong = best(__file__, ("echo", asked), ("gateway", asked), ("gateway", ping))
    row("bare picows echo", base)
    row(f"gateway: read ({read['size']:.0f} B)", read, base)
    row("gateway: ping", pong, base)
    print(f"  floor {FLOOR}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        if sys.argv[2] == "echo":
            uvloop.run(echo())
        else:
            from served import serve_gateway

            serve_gateway()
    elif sys.argv[1:2] == ["load"]:
        uvloop.run(load(*sys.argv[2:5]))
    else:
        main()
