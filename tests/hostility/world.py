"""The gateway under attack, in a process of its own: prints its address, serves until it is killed.

A robot `main` with whatever is dear to serve, a robot `spare` that is stopped meanwhile, and in a
tenant of its own a robot `wide` with as many resources as one session may subscribe to.
Run: python world.py FOLDER
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import uvloop

from configuration import key, listener, role, rule, table
from rcp_gateway.log import configure
from rcp_gateway.server import Prepared, prepare, running
from rcp_kernel.config.file import BackendConfig, parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host, Progress
from rcp_kernel.types import Point, PoseStamped, Quaternion, Twist
from rcpd.garbage import collected_at_rest

MAP = 5_000_000  # bytes
WIDE = 20_000  # resources
TEXTS, LONG = 1000, 16_000  # values of a pattern, and characters of each
JOINTS = 50  # elements of a value in conditions
POSES = 50.0  # Hz
_POSE = PoseStamped(Point(1.0, 2.0, 0.0), Quaternion(), "map", "2026-05-29T14:12:04Z")
CONFIG = (
    'name = "attacked"\n'
    + table("log", level="error")
    + listener()
    + table("plugins.mcp")
    + table("plugins.a2a")
    + table("tenants.alpha")
    + table("tenants.beta")
    + table("anonymous", role="viewer", tenants=["alpha"])
    + role(
        "asking",
        rule("*", "/**"),
        rule("*", "/system/plans", "/system/approvals"),
        approve=["/action/ask"],
    )
    + key("operator", "operator-of-the-attack", role=["operator", "asking"], tenants=["alpha"])
    + key("auditor", "auditor-of-the-attack", role="admin")
    + key("surveyor", "surveyor-of-the-attack", role="viewer", tenants=["beta"])
    + key("guard", "guard-against-attack", role="admin")
)


class NoOptions(msgspec.Struct):
    """Nothing to configure."""


class Longest:
    """The most that one turn of the loop has cost, in seconds of this thread.

    Unlike delays that others see, it does not depend on what else runs on the machine.
    """

    def __init__(self) -> None:
        self.worst = 0.0
        self._last = time.thread_time()
        self._look()

    def _look(self) -> None:
        moment = time.thread_time()
        self.worst = max(self.worst, moment - self._last)
        self._last = moment
        asyncio.get_running_loop().call_later(0.001, self._look)


class Robot(BaseBackend):
    """Takes everything, at once."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.longest = Longest()
        self.values: dict[str, Any] = {"sensor/pose": _POSE, "actuator/drive": Twist()}
        """By name, what it reads at its sensors."""

    def measure(self, name: str, value: Any) -> None:
        """Publish the value of a sensor, and keep it for those who ask."""
        self.values[name] = value
        self.host.publish(name, value)

    async def read(self, name: str) -> Any:
        """Measure; tell how long the loop was held at most since this was written last."""
        return self.longest.worst if name == "param/turn" else self.values.get(name, 0)

    async def write(self, name: str, value: Any) -> None:
        """Take a value."""
        if name == "param/turn":
            self.longest.worst = value

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Answer with what was asked."""
        return value

    async def halt(self) -> None:
        """Be at rest, as always."""


def _main(host: Host) -> Robot:
    host.declare(
        Resource(name="sensor/pose", description="A pose.", value=PoseStamped, live=True),
        Resource(name="sensor/map", description="A map.", value=bytes, live=True),
        Resource(name="sensor/grid", description="A map.", value=list[int], live=True),
        Resource(name="sensor/joints", description="Positions.", value=list[float], live=True),
        Resource(name="actuator/drive", description="Speed.", value=Twist, safe=Twist()),
        Resource(name="param/turn", description="Seconds that a turn took.", value=float),
        Resource(name="param/any", description="Anything.", value=Any),
        Resource(name="service/echo", description="Echo.", input=Any, output=Any),
        Resource(name="action/go", description="Goes.", input=Any, output=Any, policy="parallel"),
        Resource(name="action/ask", description="Asks.", input=Any, output=Any, policy="parallel"),
        *(
            Resource(name=f"sensor/text-{n:04}", description="A text.", value=str, live=True)
            for n in range(TEXTS)
        ),
    )
    robot = Robot(host)
    robot.measure("sensor/map", bytes(MAP))
    robot.measure("sensor/grid", [-1, 0, 100, 100] * (MAP // 20))
    robot.measure("sensor/joints", [0.5] * JOINTS)
    for number in range(TEXTS):
        robot.measure(f"sensor/text-{number:04}", "x" * LONG)
    return robot


async def _pose(host: Host) -> None:
    loop = asyncio.get_running_loop()
    due = loop.time()
    while True:
        host.publish("sensor/pose", _POSE)
        due = max(due + 1 / POSES, loop.time() - 0.1)
        await asyncio.sleep(max(0.0, due - loop.time()))


@asynccontextmanager
async def _open(_config: NoOptions, host: Host) -> AsyncGenerator[Robot]:
    robot = _main(host)
    publishing = asyncio.create_task(_pose(host))
    try:
        yield robot
    finally:
        publishing.cancel()


@asynccontextmanager
async def _spare(_config: NoOptions, host: Host) -> AsyncGenerator[Robot]:
    host.declare(Resource(name="actuator/drive", description="Speed.", value=Twist, safe=Twist()))
    yield Robot(host)


@asynccontextmanager
async def _wide(_config: NoOptions, host: Host) -> AsyncGenerator[BaseBackend]:
    for number in range(WIDE):
        name = f"sensor/level-{number:05}"
        host.declare(Resource(name=name, description="A level.", value=float, live=True))
        host.publish(name, 0.5)
    yield BaseBackend()


async def _serve(folder: Path) -> None:
    configure("error")
    bare = prepare(parse(CONFIG + table("store", path=folder / "store.db"), "attacked"), "attacked")
    backends = (
        BackendConfig(use="main", name="main", tenant="alpha"),
        BackendConfig(use="spare", name="spare", tenant="alpha", robot="spare"),
        BackendConfig(use="wide", name="wide", tenant="beta"),
    )
    config = msgspec.structs.replace(bare.config, backends=backends)
    bare.plugins.backends["main"] = BackendKind("main", NoOptions, _open)
    bare.plugins.backends["spare"] = BackendKind("spare", NoOptions, _spare)
    bare.plugins.backends["wide"] = BackendKind("wide", NoOptions, _wide)
    options = (NoOptions(), NoOptions(), NoOptions())
    made = Prepared(config, bare.plugins, options, bare.transports, bare.adapters, bare.features)
    async with running(made) as server:
        loop = asyncio.get_running_loop()
        with collected_at_rest(loop, lambda: server.gateway.moving):
            url = next(f["url"] for f in server.status.transports if "url" in f)
            sys.stdout.write(f"{url}\n")
            sys.stdout.flush()
            await asyncio.Event().wait()


if __name__ == "__main__":
    uvloop.run(_serve(Path(sys.argv[1])))
