"""The gateway with a backend that publishes as a benchmark wants it.

python gateway.py RATE BURST SIZE: RATE updates a second in bursts of BURST; SIZE bytes, or 0 for
the update of about 300 B. A fourth word, HZ, publishes both: the update at RATE, bytes at HZ.
Prints its port, then serves until its input ends.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from contextlib import asynccontextmanager
from typing import Annotated

import msgspec
import uvloop
from source import UPDATE

from rcp_gateway.log import configure
from rcp_gateway.server import Prepared, prepare, running
from rcp_kernel.config.file import BackendConfig, parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend
from rcp_kernel.types import Point, PoseStamped, Quaternion

RATE, BURST, SIZE = float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
BOTH = float(sys.argv[4]) if len(sys.argv) > 4 else 0.0
CONFIG = """
log = {level = "error"}
limits = {sessions = 5000}
[transports.asgi]
port = 0
"""


Micros = Annotated[int, msgspec.Meta(ge=0, le=2**53 - 1)]


class Update(msgspec.Struct):
    position: Point
    orientation: Quaternion
    frame_id: str
    timestamp: str
    sent: Micros
    note: str


class Nothing(msgspec.Struct):
    pass


async def produce(host) -> None:
    loop = asyncio.get_running_loop()
    first = msgspec.convert(UPDATE, Update)
    blob = os.urandom(SIZE)
    period, due = BURST / RATE, loop.time()
    while True:
        for _ in range(BURST):
            if SIZE and not BOTH:
                host.publish("sensor/blob", blob)
            else:
                host.publish(
                    "sensor/pose", msgspec.structs.replace(first, sent=time.time_ns() // 1000)
                )
        due = max(due + period, loop.time() - period)
        await asyncio.sleep(max(0.0, due - loop.time()))


async def produce_maps(host) -> None:
    blob = os.urandom(SIZE)
    while True:
        host.publish("sensor/blob", blob)
        await asyncio.sleep(1 / BOTH)


@asynccontextmanager
async def open_bench(_config: Nothing, host):
    host.declare(
        Resource(name="sensor/pose", description="An update.", value=Update, live=True),
        Resource(name="sensor/blob", description="Bytes.", value=bytes, live=True),
        Resource(name="sensor/still", description="A pose.", value=PoseStamped, live=True),
    )
    still = PoseStamped(Point(1.23, 4.56), Quaternion(), "map", "2026-05-29T14:12:04Z")
    host.publish("sensor/still", still)
    tasks = [asyncio.create_task(produce(host))] if RATE else []
    if BOTH:
        tasks.append(asyncio.create_task(produce_maps(host)))
    yield BaseBackend()
    for task in tasks:
        task.cancel()


async def main() -> None:
    configure("error")
    bare = prepare(parse(CONFIG, "bench"), "bench")
    config = msgspec.structs.replace(
        bare.config, backends=(BackendConfig(use="bench", name="bench", tenant="t"),)
    )
    bare.plugins.backends["bench"] = BackendKind("bench", Nothing, open_bench)
    made = Prepared(
        config, bare.plugins, (Nothing(),), bare.transports, bare.adapters, bare.features
    )
    async with running(made) as server:
        url = next(facts["url"] for facts in server.status.transports if "url" in facts)
        print(url.rpartition(":")[2].strip("/"), flush=True)
        await asyncio.to_thread(sys.stdin.read)


uvloop.run(main())
