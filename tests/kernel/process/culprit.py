"""A gateway of its own process, with one robot that behaves and one that tries to end it.

Run as `python -m kernel.process.culprit <where> <what>`: tells on its output how others fared.
"""

# ruff: noqa: T201 - its output is what the test reads

from __future__ import annotations

import asyncio
import os
import sys
import threading
import time
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import Any, NoReturn

from configuration import backend
from kernel.world import CONFIG, Client, NoOptions, Robot, prepared
from rcp_gateway.log import configure
from rcp_gateway.server import running
from rcp_kernel.config.file import parse
from rcp_kernel.spi import BackendKind, Host, Progress
from rcpd.process import end_in_time, run_contained
from rcpd.serve import loop_factory

EXITS = {"exit": SystemExit(3), "interrupt": KeyboardInterrupt()}
WHERE, WHAT = ([*sys.argv[1:], "", ""])[:2]
TEXT = CONFIG + backend("culprit", "beta", use="culprit")


def end() -> NoReturn:
    raise EXITS[WHAT]


class Culprit(Robot):
    """Ends the process where it is told to."""

    async def read(self, name: str) -> Any:
        if WHERE == "read":
            end()
        return await super().read(name)

    async def write(self, name: str, value: Any) -> Any:
        if WHERE == "write":
            end()

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        if WHERE == "execute":
            end()
        return value

    @asynccontextmanager
    async def watch(self, name: str, rate: float | None) -> AsyncIterator[None]:
        if WHERE == "watch":
            end()
        yield

    async def halt(self) -> None:
        if WHERE == "halt":
            end()

    def motion(self, robot: str | None) -> Any:
        if WHERE == "motion":
            end()
        return super().motion(robot)

    def hold_stop(self, robot: str | None) -> None:
        if WHERE == "hold_stop":
            end()


class Bomb:
    """A value whose conversion ends the process."""

    def __getattribute__(self, name: str) -> Any:
        end()


@asynccontextmanager
async def open_culprit(_config: NoOptions, host: Host) -> AsyncGenerator[Robot]:
    if WHERE == "open":
        end()
    robot = Culprit(host)
    robot.declare()
    loop = asyncio.get_running_loop()
    if WHERE == "task":
        task = loop.create_task(_later())
        robot.task = task  # type: ignore[attr-defined]
    if WHERE == "timer":
        loop.call_later(0.05, end)
    if WHERE == "call_soon":
        threading.Thread(target=lambda: host.call_soon(end)).start()
    if WHERE == "publish":
        host.publish("sensor/level", Bomb())
    if WHERE == "thread":
        threading.Thread(target=time.sleep, args=(3600,), name="left behind").start()
    if WHERE == "executor":
        loop.run_in_executor(None, time.sleep, 3600)
    yield robot
    if WHERE == "close":
        end()


async def _later() -> None:
    await asyncio.sleep(0.05)
    end()


async def main() -> None:
    made = prepared(parse(TEXT, "test"), [])
    made.plugins.backends["culprit"] = BackendKind("culprit", NoOptions, open_culprit)
    async with running(made) as server:
        client = Client(server.client_api, "admin-admin-admin")
        await asyncio.sleep(0.2)
        requests: list[dict[str, Any]] = [
            {"type": "read", "path": "/tenant/beta/param/limit"},
            {"type": "write", "path": "/tenant/beta/param/limit", "body": 1.0},
            {"type": "execute", "path": "/tenant/beta/service/echo", "body": "x"},
            {"type": "subscribe", "path": "/tenant/beta/sensor/lazy"},
            {"type": "read", "path": "/tenant/beta/sensor/level", "deadline": 0.2},
            {
                "type": "execute",
                "path": "/system/estop",
                "body": {"scope": "culprit"},
                "deadline": 0.5,
            },
        ]
        for request in requests:
            reply = await client.ask(**request)
            print("answered", request["type"], reply["status"], flush=True)
        other = await client.ask(type="execute", path="/tenant/alpha/service/echo", body="here")
        print("other", other.get("body"), flush=True)
    print("closed", flush=True)


if __name__ == "__main__":
    configure("warning", "json")
    with asyncio.Runner(loop_factory=loop_factory()) as runner:
        run_contained(runner, main())
        end_in_time(partial(os._exit, 0))
