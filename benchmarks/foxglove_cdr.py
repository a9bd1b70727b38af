"""CDR and JSON by the Foxglove protocol, and images beside foxglove-sdk. Run: python benchmarks/foxglove_cdr.py

The baseline is a bare picows server that writes the same frames, joined where they are short, and
knows nothing of robots (pip install foxglove-sdk).
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import msgspec
import uvloop
from measure import SECONDS, best, row
from picows import WSListener, WSMsgType, ws_connect, ws_create_server

from rcp_gateway.log import configure
from rcp_gateway.server import Prepared, prepare, running
from rcp_kernel.config.file import BackendConfig, parse
from rcp_kernel.model import NativeType, Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host
from rcpd.garbage import collected_at_rest

SHORT, IMAGE = 300, 1_000_000
BURST = 16
OFFERED = {SHORT: 400_000, IMAGE: 1600}  # deliveries a second
CONFIG = 'log = {level = "error"}\n[plugins.foxglove]\ndepth = 64\n[transports.asgi]\nport = 0\n'
TYPE = NativeType(
    name="sensor_msgs/msg/CompressedImage",
    encoding="cdr",
    schema_encoding="ros2msg",
    schema="uint8[] data",
)


class Nothing(msgspec.Struct):
    """No options."""


class Bytes:
    """A message in serialised form."""

    __slots__ = ("data",)

    def __init__(self, data: bytes) -> None:
        self.data = data

    def decode(self) -> object:
        raise AssertionError("nobody asked for the value")


async def produce(publish, rate: float, burst: int) -> None:
    loop = asyncio.get_running_loop()
    due = loop.time()
    while True:
        for _ in range(burst):
            publish()
        due = max(due + burst / rate, loop.time() - 0.1)
        await asyncio.sleep(max(0.0, due - loop.time()))


def pace(size: int, clients: int) -> tuple[float, int]:
    return OFFERED[size] / clients, BURST if size == SHORT else 1


class Bare(WSListener):
    clients: list = []  # noqa: RUF012 - of the one server in this process

    def on_ws_connected(self, transport):
        transport.underlying_transport.set_write_buffer_limits(high=65_536)
        Bare.clients.append(transport.underlying_transport)


async def bare(size: int, clients: int) -> None:
    server = await ws_create_server(lambda _: Bare(), "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    length = size + 13
    wide = length >= 65_536
    head = (b"\x82\x7f" if wide else b"\x82\x7e") + length.to_bytes(8 if wide else 2, "big")
    body = b"\x01" + bytes(12) + os.urandom(size)
    rate, burst = pace(size, clients)

    def publish() -> None:
        for transport in Bare.clients:
            if transport.is_closing() or transport.get_write_buffer_size() > 65_536:
                continue
            if size == SHORT:
                transport.write(b"".join([head + body] * burst))
            else:
                transport.write(head)
                transport.write(body)

    await produce(publish, rate / burst, 1)


async def gateway(size: int, clients: int) -> None:
    configure("error")
    prepared = prepare(parse(CONFIG, "benchmark"), "benchmark")
    hosts: list[Host] = []

    @asynccontextmanager
    async def open_bench(_config: Nothing, host: Host) -> AsyncGenerator[BaseBackend]:
        resource = Resource(
            name="sensor/image",
            description="Bytes.",
            value=bytes,
            live=True,
            native=TYPE.name,
            native_types={"value": TYPE},
        )
        host.declare(resource)
        hosts.append(host)
        yield BaseBackend()

    backend = BackendConfig(use="bench", name="bench", tenant="t")
    config = msgspec.structs.replace(prepared.config, backends=(backend,))
    prepared.plugins.backends["bench"] = BackendKind("bench", Nothing, open_bench)
    made = Prepared(
        config,
        prepared.plugins,
        (Nothing(),),
        prepared.transports,
        prepared.adapters,
        prepared.features,
    )
    data = os.urandom(size)
    async with running(made) as server:
        url = next(facts["url"] for facts in server.status.transports if "url" in facts)
        with collected_at_rest(asyncio.get_running_loop(), moving=lambda: False):
            print(url.rpartition(":")[2], flush=True)
            host = hosts[0]
            await produce(lambda: host.publish("sensor/image", Bytes(data)), *pace(size, clients))


def sdk(size: int, clients: int) -> None:
    import time

    import foxglove

    server = foxglove.start_server(name="bench", host="127.0.0.1", port=0)
    channel = foxglove.Channel("/update", message_encoding="json")
    print(server.port, flush=True)
    data = os.urandom(size)
    rate, burst = pace(size, clients)
    due = time.monotonic()
    parent = os.getppid()
    while os.getppid() == parent:
        for _ in range(burst):
            channel.log(data)
        due = max(due + burst / rate, time.monotonic() - 0.1)
        time.sleep(max(0.0, due - time.monotonic()))


class Subscriber(WSListener):
    done = 0
    subscribed = 0

    def on_ws_frame(self, transport, frame):
        if frame.msg_type == WSMsgType.BINARY:
            Subscriber.done += 1
            return
        message = json.loads(frame.get_payload_as_bytes())
        if message["op"] == "advertise" and message["channels"]:
            channel = message["channels"][0]["id"]
            wanted = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel}]}
            transport.send(WSMsgType.TEXT, json.dumps(wanted).encode())
            Subscriber.subscribed += 1


async def load(port: str, server: str, clients: str) -> None:
    path = "/foxglove/t" if server.startswith("gateway") else "/"
    for _ in range(int(clients)):
        await ws_connect(
            Subscriber,
            f"ws://127.0.0.1:{port}{path}",
            extra_headers={"Sec-WebSocket-Protocol": "foxglove.sdk.v1"},
            max_frame_size=1 << 26,
        )
    await asyncio.sleep(0.7)
    if not Subscriber.done:
        sys.exit("the clients got nothing")
    print("ready", flush=True)
    before = Subscriber.done
    await asyncio.sleep(SECONDS)
    print(json.dumps({"done": Subscriber.done - before}), flush=True)


def main() -> None:
    for title, size, clients, others in (
        ("300 B", SHORT, 10, ("bare", "gateway", "sdk")),
        ("300 B", SHORT, 50, ("bare", "gateway", "sdk")),
        ("1 MB", IMAGE, 4, ("bare", "gateway", "sdk")),
    ):
        names = [(f"{kind}-{size}-{clients}", str(clients)) for kind in others]
        base, ours, theirs = best(__file__, *names)
        row(f"{title} to {clients}: bare picows", base)
        row(f"{title} to {clients}: gateway, CDR", ours, base)
        row(f"{title} to {clients}: foxglove-sdk", theirs, base)
        print(f"  gateway / foxglove-sdk {ours['per_cpu'] / theirs['per_cpu']:.2f} x")


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        kind, size, number = sys.argv[2].split("-")
        if kind == "sdk":
            sdk(int(size), int(number))
        else:
            uvloop.run({"bare": bare, "gateway": gateway}[kind](int(size), int(number)))
    elif sys.argv[1:2] == ["load"]:
        uvloop.run(load(*sys.argv[2:5]))
    else:
        main()
