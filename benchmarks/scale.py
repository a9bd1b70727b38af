"""How cost and memory grow: 100 … 10 000 resources, 10 … 1 000 subscriptions, and sessions.

In memory, without sockets: this is the kernel alone. Per-message cost has to stay flat as the
tree grows. Run: python benchmarks/scale.py
"""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from types import SimpleNamespace

import msgspec
import psutil

from rcp_gateway.log import configure
from rcp_gateway.server import Prepared, running
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend
from rcp_kernel.types import Point, PoseStamped
from rcp_kernel.values import Encoding

CONFIG = """
transports = {asgi = false, http = false, ws = false, sse = false}
limits = {sessions = 5000}
[[backends]]
use = "many"
tenant = "t"
"""
MESSAGES = 20_000


class Nothing(msgspec.Struct):
    pass


def rss() -> int:
    gc.collect()
    return psutil.Process().memory_info().rss


@asynccontextmanager
async def gateway():
    hosts = []

    @asynccontextmanager
    async def open_many(_config, host) -> AsyncGenerator[BaseBackend]:
        hosts.append(host)
        yield BaseBackend()

    kind = BackendKind("many", Nothing, open_many)
    plugins = SimpleNamespace(
        backends={"many": kind}, transports={}, adapters={}, missing=[], points={"plugins": {}},
        is_missing=lambda *_: None,
    )  # fmt: skip
    prepared = Prepared(parse(CONFIG, "bench"), plugins, (Nothing(),), {}, {})
    async with running(prepared) as server:
        yield server, hosts[0]


def declare(host, count: int) -> None:
    host.declare(
        *(
            Resource(
                name=f"sensor/group{i % 100}/pose{i}",
                description="A pose.",
                value=PoseStamped,
                live=True,
                deadline=1.0,
            )
            for i in range(count)
        )
    )


async def growth(resources: int, subscriptions: int) -> tuple[float, float, float]:
    """Return µs for a publish with one subscriber, µs for a read, bytes for a resource."""
    async with gateway() as (server, host):
        before = rss()
        declare(host, resources)
        value = PoseStamped(Point(1.0, 2.0))
        for i in range(resources):
            host.publish(f"sensor/group{i % 100}/pose{i}", value)
        memory = (rss() - before) / resources
        principal = server.gateway.identities.anonymous()
        connection = server.client_api.connect(principal, Encoding.JSON, lambda: None)
        for i in range(subscriptions):
            path = f"/sensor/group{i % 100}/pose{i}"
            text = f'{{"type":"subscribe","id":"s{i}","path":"{path}"}}'
            connection.receive(text.encode())
        connection.outbox.collect(1 << 30)
        names = [f"sensor/group{i % 100}/pose{i}" for i in range(subscriptions)]
        started = time.perf_counter()
        for i in range(MESSAGES):
            host.publish(names[i % subscriptions], value)
            connection.outbox.collect()
        publish = (time.perf_counter() - started) / MESSAGES * 1e6
        requests = [
            f'{{"type":"read","id":"r","path":"/tenant/t/{name}"}}'.encode() for name in names
        ]
        started = time.perf_counter()
        for i in range(MESSAGES):
            connection.receive(requests[i % subscriptions])
            connection.outbox.collect()
        read = (time.perf_counter() - started) / MESSAGES * 1e6
        connection.close()
        return publish, read, memory


async def session_memory(count: int) -> float:
    """Return bytes for a connected session with one subscription."""
    async with gateway() as (server, host):
        declare(host, 1)
        principal = server.gateway.identities.anonymous()
        before = rss()
        kept = []
        for _ in range(count):
            connection = server.client_api.connect(principal, Encoding.JSON, lambda: None)
            connection.receive(b'{"type":"subscribe","id":"s","path":"/sensor/group0/pose0"}')
            connection.outbox.collect()
            kept.append(connection)
        return (rss() - before) / count


async def main() -> None:
    configure("error")
    # First, while the process has no freed memory to hand out again.
    print(f"memory per session with one subscription: {await session_memory(2000) / 1000:.1f} kB")
    print("resources  subscriptions  publish+deliver µs  read µs  memory per 1000 resources MB")
    for resources, subscriptions in ((100, 10), (1000, 100), (10_000, 1000)):
        publish, read, memory = await growth(resources, subscriptions)
        print(
            f"{resources:9}  {subscriptions:13}  {publish:18.2f}  {read:7.2f}  {memory / 1000:10.2f}"
        )


asyncio.run(main())
