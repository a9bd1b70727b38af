"""The gateway that the transports' benchmarks measure: one robot, published as each of them wants."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import msgspec
import uvloop

from rcp_gateway.log import configure
from rcp_gateway.server import Prepared, prepare, running
from rcp_kernel.config.file import BackendConfig, parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host, Progress
from rcp_kernel.types import Point, PoseStamped, Quaternion
from rcpd.garbage import collected_at_rest

POSE = PoseStamped(Point(1.25, -3.5, 0.125), Quaternion(), "map", "2026-05-29T14:12:04Z")
_CONFIG = 'limits = {sessions = 5000}\nlog = {level = "error"}\n[transports.asgi]\nport = 0\n'


class Nothing(msgspec.Struct):
    """No options."""


class Bench(BaseBackend):
    """Publishes when it is told to."""

    def __init__(self, host: Host) -> None:
        self.host = host

    def publish(self) -> None:
        self.host.publish("sensor/pose", POSE)

    async def write(self, name: str, value: float) -> None:
        """Take everything."""

    async def execute(self, name: str, value: float, progress: Progress) -> float:
        """Add one."""
        return value + 1.0


@asynccontextmanager
async def gateway(more: str = "") -> AsyncGenerator[tuple[Bench, str]]:
    """Run the gateway; yield its robot and its URL. `more` is added to its
    configuration, first lines of `[transports.asgi]`."""
    configure("error")
    bare = prepare(parse(_CONFIG + more, "benchmark"), "benchmark")
    robots: list[Bench] = []

    @asynccontextmanager
    async def open_bench(_config: Nothing, host: Host) -> AsyncGenerator[Bench]:
        host.declare(
            Resource(name="sensor/pose", description="A pose.", value=PoseStamped, live=True),
            Resource(name="param/speed", description="A speed.", value=float),
            Resource(name="service/add", description="Adds one.", input=float, output=float),
        )
        robots.append(Bench(host))
        robots[0].publish()
        yield robots[0]

    config = msgspec.structs.replace(
        bare.config, backends=(BackendConfig(use="bench", name="bench", tenant="t"),)
    )
    bare.plugins.backends["bench"] = BackendKind("bench", Nothing, open_bench)
    made = Prepared(
        config, bare.plugins, (Nothing(),), bare.transports, bare.adapters, bare.features
    )
    async with running(made) as server:
        url = next(facts["url"] for facts in server.status.transports if "url" in facts)
        yield robots[0], url


def serve_gateway(rate: float = 0.0, burst: int = 1, more: str = "") -> None:
    """Serve until killed; publish `rate` poses a second in bursts of `burst`."""

    async def main() -> None:
        loop = asyncio.get_running_loop()
        async with gateway(more) as (robot, url):
            with collected_at_rest(loop, moving=lambda: False):  # as in `rcpd`
                print(url.rpartition(":")[2], flush=True)
                await produce(robot.publish, rate, burst)

    uvloop.run(main())


async def produce(publish, rate: float, burst: int) -> None:
    """Call `publish` so many times a second; 0 never does."""
    loop = asyncio.get_running_loop()
    due = loop.time()
    while rate:
        for _ in range(burst):
            publish()
        due = max(due + burst / rate, loop.time() - 0.1)
        await asyncio.sleep(max(0.0, due - loop.time()))
    await asyncio.Event().wait()
