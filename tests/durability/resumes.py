"""Cut a session again and again, come back to it, and see that it answers: run by test_resumes.py.

Each life of the gateway is a fork of this process, as in crash.py, and ends by SIGKILL while a burst
of requests is under way. In between the client is cut off as a killed one is, and comes back too.
By hand: `PYTHONPATH=tests python tests/durability/resumes.py FOLDER CYCLES SEED`.
"""

from __future__ import annotations

import asyncio
import json
import os
import random
import signal
import sys
from collections import Counter
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec
import uvloop
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from configuration import backend, key, listener, table
from rcp_gateway.log import configure
from rcp_gateway.testing import ScriptedRobot, serve
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, Host, Progress
from rcp_kernel.types import quantity

KEY = "operator-operator"
CONFIG = listener() + backend() + key("operator", KEY)
CUTS = 4  # of the client, in each life of the gateway
BURST = 400  # commands under way when the connection is cut: more than `backlog`
BOUND = 10.0  # s that an answer may take
FINAL = ("completed", "failed", "rejected", "cancelled")


async def run(value: Any, progress: Progress) -> Any:
    """Be done at once."""
    return value


async def measure(robot: ScriptedRobot) -> None:
    """Publish at 100 Hz."""
    for number in range(1_000_000):
        robot.measure("sensor/level", float(number))
        await asyncio.sleep(0.01)


@asynccontextmanager
async def open_robot(_config: msgspec.Struct, host: Host) -> AsyncGenerator[ScriptedRobot]:
    """Run what it is told at once, and measure all the time."""
    robot = ScriptedRobot(
        host,
        Resource(name="service/run", description="Runs.", input=str, output=str),
        Resource(name="sensor/level", description="A level.", value=quantity("m"), live=True),
        behaviours={"service/run": run},
    )
    measuring = asyncio.create_task(measure(robot))
    try:
        yield robot
    finally:
        measuring.cancel()


def live(folder: Path, ready: int) -> None:
    """Be a gateway until killed."""
    configure("error", "json")

    async def main() -> None:
        kind = BackendKind("robot", msgspec.Struct, open_robot)
        config = CONFIG + table("store", path=folder / "store.db")
        async with serve(parse(config, "resumes"), kind) as served:
            port = next(f["port"] for f in served.server.status.transports if "port" in f)
            os.write(ready, f"{port}\n".encode())
            await asyncio.Event().wait()

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main())


class Deaf(Exception):
    """The gateway answers no more."""


class Visitor:
    """One client, over all lives of the gateway."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._hello: dict[str, Any] = {}
        self._number = 0

    async def visit(self, port: int, gateway: int) -> None:
        """Come back a few times; the last time the gateway is killed under a burst."""
        for cut in range(CUTS):
            self.counts["cycles"] += 1
            async with connect(
                f"ws://127.0.0.1:{port}/rcp/v1/ws",
                additional_headers={"Authorization": f"Bearer {KEY}"},
                compression=None,
                ping_interval=None,
                max_queue=None,
            ) as socket:
                await self._greet(socket)
                await self._burst(socket, execute=False)
                await self._burst(socket, execute=True)
                await self._send(socket, BURST, execute=True)
                await asyncio.sleep(random.uniform(0, 0.05))
                if cut == CUTS - 1:
                    os.kill(gateway, signal.SIGKILL)
                else:
                    socket.transport.abort()

    async def _greet(self, socket: ClientConnection) -> None:
        """Say `hello` and the first requests in one breath."""
        body = self._hello
        await socket.send(json.dumps({"type": "hello", "id": "hello", "body": body}))
        ids = await self._send(socket, BURST, execute=False)
        reply = await self._reply(socket, {"hello"} | ids)
        told = reply["hello"]
        if told["status"] != "completed":
            assert told["error"]["code"] == "gap", told
            self.counts["lost"] += 1
            self._hello = {}
            await self._greet(socket)
            return
        self.counts["resumed" if body else "begun"] += 1
        self._hello = {name: told["body"][name] for name in ("session", "resume_token")}
        if not body:
            await socket.send(
                json.dumps({"type": "subscribe", "id": "level", "path": "/sensor/level"})
            )

    async def _send(self, socket: ClientConnection, count: int, *, execute: bool) -> set[str]:
        ids: set[str] = set()
        for _ in range(count):
            self._number += 1
            id_ = f"r{self._number}"
            ids.add(id_)
            if execute:
                request = {"type": "execute", "path": "/service/run", "body": id_}
            else:
                request = {"type": "read", "path": "/sensor/level"}
            await socket.send(json.dumps({"id": id_, **request}))
        return ids

    async def _burst(self, socket: ClientConnection, *, execute: bool) -> None:
        for count in (1, 1, 20, 100 if execute else BURST):
            ids = await self._send(socket, count, execute=execute)
            await self._reply(socket, ids)
        await socket.send(json.dumps({"type": "ping", "id": "ping"}))
        await self._reply(socket, {"ping"})

    async def _reply(self, socket: ClientConnection, ids: set[str]) -> dict[str, dict[str, Any]]:
        """Read until every request has its one final reply."""
        waiting = set(ids)
        found: dict[str, dict[str, Any]] = {}
        try:
            async with asyncio.timeout(BOUND):
                while waiting:
                    told = json.loads(await socket.recv())
                    if told.get("id") in ids and told.get("status") in FINAL:
                        waiting.discard(told["id"])
                        found[told["id"]] = told
                    self.counts[told["type"]] += 1
        except TimeoutError:
            raise Deaf(f"{len(waiting)} of {len(ids)} requests have no answer") from None
        return found


def begun(folder: Path) -> tuple[int, int]:
    """Begin a life; return its process and port."""
    told, ready = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            live(folder, ready)
        finally:
            os._exit(1)
    os.close(ready)
    with os.fdopen(told) as pipe:
        return pid, int(pipe.readline())


def main(folder: Path, cycles: int, seed: int) -> None:
    """Come back until it was often enough."""
    random.seed(seed)
    visitor = Visitor()
    while visitor.counts["cycles"] < cycles:
        pid, port = begun(folder)
        try:
            with suppress(ConnectionClosed):
                asyncio.run(visitor.visit(port, pid))
        except Deaf as error:
            visitor.counts["deaf"] += 1
            sys.stderr.write(f"{error}\n")
        finally:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
    sys.stdout.write(json.dumps(visitor.counts))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
