"""A gateway whose robot is busy in every way, and prints the time at which it is told to halt.

Prints its port, then the monotonic nanoseconds of each halt, until its input ends.
"""

from __future__ import annotations

import asyncio
import sys
import time
from contextlib import asynccontextmanager

import msgspec
import uvloop

from rcp_gateway.log import configure
from rcp_gateway.server import Prepared, prepare, running
from rcp_kernel.config.file import BackendConfig, parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend
from rcp_kernel.types import Twist
from rcpd.garbage import collected_at_rest

ACTIONS = 20
RATE = 50  # samples a second of each sensor
SENSORS = 4
CONFIG = """
log = {level = "error"}
[[keys]]
name = "admin"
role = "admin"
key = "admin-of-the-benchmark"
[transports.asgi]
port = 0
"""


class Nothing(msgspec.Struct):
    pass


class Busy(BaseBackend):
    def __init__(self, host) -> None:
        self.host = host

    async def write(self, name: str, value) -> None:
        await asyncio.sleep(0.01)

    async def execute(self, name: str, value, progress) -> None:
        await asyncio.Event().wait()

    async def halt(self) -> None:
        print(time.monotonic_ns(), flush=True)


async def produce(host) -> None:
    while True:
        for number in range(SENSORS):
            host.publish(f"sensor/s{number}", "x" * 300)
        await asyncio.sleep(1 / RATE)


@asynccontextmanager
async def open_busy(_config: Nothing, host):
    about = {"description": "Of the benchmark."}
    for number in range(SENSORS):
        host.declare(Resource(name=f"sensor/s{number}", value=str, live=True, **about))
    for number in range(ACTIONS):
        host.declare(Resource(name=f"action/a{number}", policy="queue", **about))
    host.declare(Resource(name="actuator/drive", value=Twist, valid_for=1.0, safe=Twist(), **about))
    task = asyncio.create_task(produce(host))
    yield Busy(host)
    task.cancel()


async def main() -> None:
    configure("error")
    bare = prepare(parse(CONFIG, "bench"), "bench")
    config = msgspec.structs.replace(
        bare.config, backends=(BackendConfig(use="bench", name="bench", tenant="t"),)
    )
    bare.plugins.backends["bench"] = BackendKind("bench", Nothing, open_busy)
    made = Prepared(
        config, bare.plugins, (Nothing(),), bare.transports, bare.adapters, bare.features
    )
    async with running(made) as server:
        url = next(facts["url"] for facts in server.status.transports if "url" in facts)
        loop, kernel = asyncio.get_running_loop(), server.gateway
        with collected_at_rest(loop, lambda: kernel.moving):
            print(url.rpartition(":")[2].strip("/"), flush=True)
            await asyncio.to_thread(sys.stdin.read)


uvloop.run(main())
