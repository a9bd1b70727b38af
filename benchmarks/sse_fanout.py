"""Server-sent events to 100 clients beside a bare ASGI stream. Run: python benchmarks/sse_fanout.py"""

from __future__ import annotations

import asyncio
import json
import sys

import uvloop
from answers import Answers
from http_get import serve_app
from measure import SECONDS, best, row

CLIENTS = 100
RATE = 600.0
FLOOR = 0.8
PATH = "/rcp/v1/events?path=/tenant/t/sensor/pose"
EVENT = (
    b"id: s-0123456789abcdef0123456789abcdef:1\nevent: update\ndata: "
    b'{"type":"update","id":"sub-1234","path":"/tenant/t/sensor/pose","seq":1,'
    b'"timestamp":"2026-05-29T14:12:04.123456789Z","body":{"position":{"x":1.25,"y":-3.5,'
    b'"z":0.125},"orientation":{"x":0.0,"y":0.0,"z":0.0,"w":1.0},"frame_id":"map",'
    b'"timestamp":"2026-05-29T14:12:04Z"}}\n\n'
)


class Reader(asyncio.Protocol):
    done = 0
    answers = Answers()

    def connection_made(self, transport):
        transport.write(f"GET {PATH} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())

    def data_received(self, data):
        if data.startswith(b"HTTP/1.1 ") and not data.startswith(b"HTTP/1.1 200"):
            Reader.answers.look(data.partition(b"\r\n\r\n")[2] or b'{"error": {}}')
        Reader.done += data.count(b"event: update")


async def load(port: str) -> None:
    loop = asyncio.get_running_loop()
    for _ in range(CLIENTS):
        await loop.create_connection(Reader, "127.0.0.1", int(port))
    await asyncio.sleep(0.5)
    Reader.answers.check(Reader.done)
    print("ready", flush=True)
    before = Reader.done
    await asyncio.sleep(SECONDS)
    print(json.dumps({"done": Reader.done - before}), flush=True)


class BareStream:
    """An ASGI application that sends each event to each of its clients."""

    def __init__(self) -> None:
        self.waiting: list[asyncio.Future[bytes]] = []
        self.producer: asyncio.Task[None] | None = None

    def publish(self) -> None:
        waiting, self.waiting = self.waiting, []
        for future in waiting:
            future.set_result(EVENT)

    async def __call__(self, scope, receive, send) -> None:
        from served import produce

        loop = asyncio.get_running_loop()
        if self.producer is None:
            self.producer = loop.create_task(produce(self.publish, RATE, 1))
        headers = [(b"content-type", b"text/event-stream")]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        while True:
            future = loop.create_future()
            self.waiting.append(future)
            await send({"type": "http.response.body", "body": await future, "more_body": True})


def main() -> None:
    base, ours = best(__file__, ("bare",), ("gateway",))
    row("bare ASGI stream", base)
    row("gateway", ours, base)
    print(f"  floor {FLOOR}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        if sys.argv[2] == "gateway":
            from served import serve_gateway

            serve_gateway(RATE)
        else:
            serve_app(BareStream())
    elif sys.argv[1:2] == ["load"]:
        uvloop.run(load(sys.argv[2]))
    else:
        main()
