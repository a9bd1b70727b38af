"""How late a dead-man's stop reaches the robot when two of three stop messages are lost.

A velocity with `valid_for` of 100 ms is written and never renewed; the robot does not answer the first
two stops. Measured from the end of the window to the write of the stop that it takes.
Run: python benchmarks/deadman.py
"""

from __future__ import annotations

import asyncio
import time
from contextlib import asynccontextmanager
from math import ceil

import msgspec
import uvloop

from rcp_gateway.testing import OPERATOR, serve_backend
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend
from rcp_kernel.types import Twist

ROUNDS = 200
WINDOW = 0.1  # s


class Nothing(msgspec.Struct):
    pass


class Deaf(BaseBackend):
    """Loses as many stops as it is told to."""

    def __init__(self) -> None:
        self.lose = self.lost = 0
        self.written = 0.0
        self.stopped: asyncio.Future[float] = asyncio.get_running_loop().create_future()

    async def write(self, name: str, value) -> None:
        if value != Twist():
            self.written = time.monotonic()
            return
        moment = time.monotonic()
        if self.lost < self.lose:
            self.lost += 1
            await asyncio.Event().wait()
        if not self.stopped.done():
            self.stopped.set_result(moment)


@asynccontextmanager
async def open_deaf(_config: Nothing, host):
    host.declare(
        Resource(
            name="actuator/drive", description="Drives.", value=Twist, valid_for=1, safe=Twist()
        )
    )
    yield Deaf()


async def measured(lose: int) -> list[float]:
    async with serve_backend(BackendKind("deaf", Nothing, open_deaf)) as served:
        client, robot = served.client(OPERATOR), served.life.backend
        took = []
        for _ in range(ROUNDS):
            robot.lose, robot.lost = lose, 0
            robot.stopped = asyncio.get_running_loop().create_future()
            body = {"linear": {"x": 1.0}}
            await client.request("write", "/tenant/t/actuator/drive", body=body, valid_for=WINDOW)
            took.append((await robot.stopped - robot.written - WINDOW) * 1e3)
            await asyncio.sleep(0.02)
        return sorted(took)


async def main() -> None:
    for lose in (0, 2):
        took = await measured(lose)
        p50, p99 = took[len(took) // 2], took[ceil(len(took) * 0.99) - 1]
        print(f"{lose} of 3 lost   p50 {p50:.1f}  p99 {p99:.1f}  max {took[-1]:.1f} ms", flush=True)


uvloop.run(main())
