"""A gateway with the simulated rover, driven at 1 m/s; prints where the rover is when it is asked.

Run as `python rover.py`. A line `drive` writes a velocity that stands for half a second and prints when
it was taken; `where` prints how far the rover has driven, its speed and the time. It ends with its stdin.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import time
from typing import Any

import uvloop

from configuration import backend, configuration, key
from rcp_gateway.log import configure
from rcp_gateway.server import prepare, running
from rcp_kernel.config.file import parse
from rcp_kernel.values import Encoding

CONFIG = configuration(backend(use="sim", world="empty"), key("admin", "admin-admin-admin"))


def tell(**fact: Any) -> None:
    os.write(1, json.dumps(fact).encode() + b"\n")


async def main() -> None:
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), sys.stdin
    )
    config = parse(CONFIG, "test")
    async with running(prepare(config, "test"), configure("warning", "json")) as server:
        client_api = server.client_api

        def flush() -> None:
            for data in connection.outbox.collect():
                tell(reply=json.loads(data)["status"], at=time.monotonic())

        connection = client_api.connect(
            client_api.authenticate("admin-admin-admin"), Encoding.JSON, flush
        )
        tell(port=0, ready=os.getpid())
        while line := await reader.readline():
            backend: Any = getattr(server.supervisors[0].backend, "inner", None)
            if b"drive" in line:
                body = {"linear": {"x": 1.0}, "angular": {}}
                write = {"type": "write", "id": "w", "path": "/tenant/alpha/actuator/cmd_vel"}
                connection.receive(json.dumps({**write, "body": body, "valid_for": 0.5}).encode())
            else:
                rover = backend.device.sim.rover
                tell(travelled=rover.travelled, speed=rover.v, at=time.monotonic())


if __name__ == "__main__":
    signal.alarm(300)
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main())
