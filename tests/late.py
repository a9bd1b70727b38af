"""A gateway in a process of its own whose robot comes up after its port: `python late.py PORT SECONDS`.

The robot's `sensor/run` tells the process, so that a client knows whose sample it has.
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

import msgspec

from configuration import backend, listener, table
from ports import free_port
from rcp_gateway import server
from rcp_gateway.log import configure
from rcp_gateway.testing import serve
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host
from rcp_kernel.types import quantity

__all__ = ["PATH", "LateGateway"]

PATH = "/tenant/alpha/sensor/run"
_CONFIG = (
    table("transports", http=False, sse=False)
    + table("anonymous", role="operator")
    + backend(use="late")
)


class LateGateway:
    """The gateway over its several processes."""

    def __init__(self, late: float) -> None:
        self.port = free_port()
        self._late = late
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def start(self) -> int:
        """Start it; return the process's id, once its port is open."""
        command = [sys.executable, str(Path(__file__)), str(self.port), str(self._late)]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == b"open\n"
        return self._process.pid

    def kill(self) -> None:
        """End it as a lost machine would."""
        if self._process is not None:
            self._process.send_signal(signal.SIGKILL)
            self._process.communicate()
            self._process = None


class _NoOptions(msgspec.Struct):
    pass


async def _main(port: int, late: float) -> None:
    listening = asyncio.Event()

    @asynccontextmanager
    async def open_late(_config: _NoOptions, host: Host) -> AsyncGenerator[BaseBackend]:
        await listening.wait()
        await asyncio.sleep(late)
        run = Resource(
            name="sensor/run",
            description="Its process.",
            value=quantity("1", int),
            live=True,
        )
        host.declare(run)
        publishing = asyncio.create_task(publish(host))
        try:
            yield BaseBackend()
        finally:
            publishing.cancel()

    async def publish(host: Host) -> None:
        while True:
            host.publish("sensor/run", os.getpid())
            await asyncio.sleep(0.05)

    configure("critical")
    server._FIRST_OPEN = 0.0  # noqa: SLF001 - the port is to open before the robot is there
    config = parse(_CONFIG + listener(port), "late")
    async with serve(config, BackendKind("late", _NoOptions, open_late)):
        sys.stdout.write("open\n")
        sys.stdout.flush()
        listening.set()
        await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(_main(int(sys.argv[1]), float(sys.argv[2])))
