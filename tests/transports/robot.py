"""A gateway on a real socket, around a robot of few words."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from configuration import backend, key, listener, table
from rcp_gateway.log import configure
from rcp_gateway.server import Server
from rcp_gateway.testing import ScriptedRobot, scripted, serve
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from rcp_kernel.config.file import parse
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.model import Resource
from rcp_kernel.spi import BaseBackend, Host, Progress
from rcp_kernel.types import Pose, quantity

BOUND = 60.0  # s any wait of a test may take
KEY = "operator-of-this-test"
ROBOTS = (
    backend()
    + backend("second", "beta")
    + key("op", KEY, role="operator")
    + key("beta-only", "key-of-tenant-beta", role="operator", tenants=["beta"])
)


RESOURCES = (
    Resource(name="sensor/pose", description="A pose.", value=Pose, live=True),
    Resource(name="sensor/text", description="A text.", value=str, live=True),
    Resource(name="sensor/blob", description="Bytes.", value=bytes, live=True),
    Resource(name="sensor/silent", description="Never there.", value=quantity("m")),
    Resource(name="param/limit", description="A limit.", value=quantity("m/s", ge=0, le=2.5)),
    Resource(name="param/blob", description="Bytes.", value=bytes),
    Resource(name="param/text", description="A text.", value=str),
    Resource(
        name="action/go",
        description="Goes.",
        input=quantity("m", ge=0),
        output=quantity("m"),
        feedback=quantity("m"),
    ),
    Resource(
        name="service/add", description="Adds one.", input=quantity("1"), output=quantity("1")
    ),
)


class PublishingRobot(ScriptedRobot):
    """A robot that publishes without being watched: what it has not published has no value."""

    watch = BaseBackend.watch


def robot(host: Host) -> ScriptedRobot:
    """Make a robot with a value of each kind."""
    made = PublishingRobot(host, *RESOURCES)
    made.measure("sensor/pose", {"position": {"x": 1.0, "y": 2.0}})
    made.measure("sensor/text", "x")
    made.measure("sensor/blob", b"0123456789")
    made.measure("param/limit", 1.0)

    async def go(value: Any, progress: Progress) -> Any:
        progress(value / 2, fraction=0.5)
        if value > 100:
            raise DeviceRejected("too far")
        return await made.wait(value, progress)

    async def add(value: Any, progress: Progress) -> Any:
        return value + 1

    made.behaviours |= {"action/go": go, "service/add": add}
    return made


class Site:
    """The gateway's address and what stands behind it."""

    def __init__(self, server: Server, robots: list[ScriptedRobot]) -> None:
        self.server = server
        self.robots = robots
        self.url: str = next(f["url"] for f in server.status.transports if "url" in f)
        self.port: int = next(f["port"] for f in server.status.transports if "port" in f)

    @property
    def robot(self) -> ScriptedRobot:
        """The robot of tenant alpha."""
        return self.robots[0]

    @property
    def ws(self) -> str:
        """The WebSocket's address."""
        return f"ws://127.0.0.1:{self.port}/rcp/v1/ws"


@asynccontextmanager
async def site(
    *,
    port: int = 0,
    top: str = "",
    asgi: str = "",
    http: str = "",
    ws: str = "",
    sse: str = "",
    more: str = "",
    folder: Path | None = None,
    clock: Clock = SYSTEM_CLOCK,
) -> AsyncGenerator[Site]:
    """Run a gateway; the texts are added to its configuration, the store is in `folder` if given."""
    robots: list[ScriptedRobot] = []

    def make(host: Host) -> ScriptedRobot:
        robots.append(robot(host))
        return robots[-1]

    configure("error", "json")
    text = top + listener(port) + asgi
    for name, fields in {"http": http, "ws": ws, "sse": sse}.items():
        text += table(f"transports.{name}") + fields
    with TemporaryDirectory() as scratch:
        text += ROBOTS + more + table("store", path=f"{folder or scratch}/store.db")
        async with serve(parse(text, "test"), scripted(make), clock=clock) as served:
            yield Site(served.server, robots)


async def until(holds: Any) -> None:
    """Let the loop turn until a condition holds, within the bound."""
    async with asyncio.timeout(BOUND):
        while not holds():  # noqa: ASYNC110 - whoever changes it tells nobody
            await asyncio.sleep(0.002)
