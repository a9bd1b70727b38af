"""GET of a resource beside a stock litestar handler that returns the same dictionary.

Run: python benchmarks/http_get.py
"""

from __future__ import annotations

import asyncio
import json
import sys

import uvloop
from answers import Answers
from measure import SECONDS, best, row

CLIENTS = 32
FLOOR = 1.3
PATH = "/rcp/v1/context/tenant/t/sensor/pose"
ANSWER = {
    "type": "read",
    "path": "/tenant/t/sensor/pose",
    "status": "completed",
    "body": {
        "position": {"x": 1.25, "y": -3.5, "z": 0.125},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        "frame_id": "map",
        "timestamp": "2026-05-29T14:12:04Z",
    },
    "seq": 1,
    "source_timestamp": "2026-05-29T14:12:04.123456789Z",
    "state": "fresh",
    "timestamp": "2026-05-29T14:12:04.123456789Z",
}


class Getter(asyncio.Protocol):
    done = 0
    answers = Answers()
    request = (
        f"GET {PATH} HTTP/1.1\r\nHost: 127.0.0.1\r\nAccept: */*\r\n"
        "Accept-Encoding: gzip, deflate\r\nConnection: keep-alive\r\n"
        "User-Agent: benchmark\r\n\r\n"
    ).encode()

    def connection_made(self, transport):
        self.transport = transport
        self.buffer = b""
        transport.write(self.request)

    def data_received(self, data):
        self.buffer += data
        head, end, body = self.buffer.partition(b"\r\n\r\n")
        if not end:
            return
        length = int(head.lower().partition(b"content-length: ")[2].partition(b"\r\n")[0])
        if len(body) >= length:
            if not head.startswith(b"HTTP/1.1 200"):
                Getter.answers.refused = {"answer": self.buffer.decode("utf-8", "replace")}
                return
            self.buffer = b""
            Getter.done += 1
            self.transport.write(self.request)


async def load(port: str) -> None:
    loop = asyncio.get_running_loop()
    for _ in range(CLIENTS):
        await loop.create_connection(Getter, "127.0.0.1", int(port))
    await asyncio.sleep(0.3)
    print("ready", flush=True)
    before = Getter.done
    await asyncio.sleep(SECONDS)
    Getter.answers.check(Getter.done - before)
    print(json.dumps({"done": Getter.done - before}), flush=True)


def serve_app(app) -> None:
    import socket

    import uvicorn

    listening = socket.create_server(("127.0.0.1", 0))
    print(listening.getsockname()[1], flush=True)
    config = uvicorn.Config(
        app, http="httptools", loop="uvloop", lifespan="off", access_log=False, log_level="error"
    )
    uvicorn.Server(config).run(sockets=[listening])


def litestar_app():
    from litestar import Litestar, get

    @get(PATH, sync_to_thread=False)
    def answer() -> dict[str, object]:
        return ANSWER

    return Litestar([answer], openapi_config=None, logging_config=None)


async def bare(_scope, _receive, send) -> None:
    body = json.dumps(ANSWER).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", b"%d" % len(body))]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": body})


def main() -> None:
    base, ours, floor = best(__file__, ("litestar",), ("gateway",), ("bare",))
    row("stock litestar", base)
    row("gateway", ours, base)
    row("bare ASGI, for comparison", floor, base)
    print(f"  floor {FLOOR}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        if sys.argv[2] == "gateway":
            from served import serve_gateway

            serve_gateway()
        else:
            serve_app(litestar_app() if sys.argv[2] == "litestar" else bare)
    elif sys.argv[1:2] == ["load"]:
        uvloop.run(load(sys.argv[2]))
    else:
        main()
