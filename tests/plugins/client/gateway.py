"""A real gateway on a real port around a robot that does as a test says; it can be started anew."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any, Self

import msgspec

from configuration import backend, key, listener, table
from rcp_gateway.features import active
from rcp_gateway.log import configure
from rcp_gateway.plugins import Plugins
from rcp_gateway.server import Prepared, Server, running
from rcp_gateway.testing import ScriptedRobot
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, Host, Progress
from rcp_kernel.types import Twist, quantity
from rcp_kernel.values import value_type

OPERATOR = "operator-of-these-tests"
ADMIN = "administrator-of-these-tests"
BOUND = 60.0  # s that any wait of a test may take

ROBOTS = (
    backend("robot") + backend("other", "beta") + key("operator", OPERATOR) + key("admin", ADMIN)
)


class Point(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    x: quantity("m")  # pyright: ignore[reportInvalidTypeForm]
    y: quantity("m") = 0.0  # pyright: ignore[reportInvalidTypeForm]


class NoOptions(msgspec.Struct):
    """There is nothing to configure."""


RESOURCES = (
    Resource(
        name="sensor/count",
        description="Counts up.",
        value=quantity("1", int),
        live=True,
        history=1000,
    ),
    Resource(name="sensor/point", description="A point.", value=Point, live=True),
    Resource(name="sensor/blob", description="Many bytes.", value=bytes, live=True),
    Resource(name="event/alarm", description="An alarm.", value=str, live=True),
    Resource(
        name="param/limit",
        description="A limit.",
        value=quantity("m/s", ge=0, le=2.5),
        examples=(1.0,),
        atomic="params",
    ),
    Resource(name="param/label", description="A label.", value=str, atomic="params"),
    Resource(
        name="actuator/drive",
        description="A drive.",
        value=Twist,
        valid_for=5.0,
        safe=Twist(),
        max_age=2.0,
    ),
    Resource(
        name="action/go",
        description="Goes.",
        input=Point,
        output=Point,
        feedback=quantity("m"),
        policy="parallel",
    ),
    Resource(name="service/echo", description="Answers.", input=bytes, output=bytes),
)


class Robot(ScriptedRobot):
    """Counts as its test wants; its action goes on until released."""

    def __init__(self, host: Host) -> None:
        super().__init__(host, *RESOURCES, values={"param/limit": 1.5, "param/label": "crate"})
        self.behaviours |= {"action/go": self.go, "service/echo": echo}
        self.published = 0

    def publish(self, times: int = 1) -> None:
        """Publish the next numbers of `sensor/count`."""
        for _ in range(times):
            self.published += 1
            self.host.publish("sensor/count", self.published)

    def say(self, name: str, value: Any) -> None:
        self.host.publish(name, value)

    async def go(self, value: Point, progress: Progress) -> Any:
        progress(value.x / 2, fraction=0.5)
        return await self.wait(value, progress)


async def echo(value: Any, progress: Progress) -> Any:
    return value


class Gateway:
    """The gateway, over its several lives."""

    def __init__(
        self,
        *,
        session_ttl: float = 60.0,
        in_flight: int = 4096,
        more: str = "",
        http: bool = False,
    ) -> None:
        self.port = 0
        self.robots: dict[str, Robot] = {}
        self._config = (
            table("transports", **({} if http else {"http": False, "sse": False}))
            + table("limits", session_ttl=session_ttl, in_flight=in_flight)
            + ROBOTS
            + more
        )
        self._stack = AsyncExitStack()
        self.opens = asyncio.Event()
        """Lets the robots come up."""
        self.opens.set()
        self.server: Server | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def robot(self) -> Robot:
        """The present life of alpha's robot."""
        return self.robots["alpha"]

    async def start(self) -> None:
        config = parse(self._config + listener(self.port, grace=0.1), "test")
        plugins = Plugins(msgspec.structs.replace(config, backends=()))
        plugins.backends["robot"] = BackendKind("robot", NoOptions, self._open)
        tables = {
            name: value_type(plugins.transports[name].config).convert(table)
            for name, table in config.transports.items()
        }
        options = tuple(NoOptions() for _ in config.backends)
        prepared = Prepared(
            config, plugins, options, tables, {}, active(config, plugins.features, "test")
        )
        configure("critical", "json")
        self.server = await self._stack.enter_async_context(running(prepared))
        urls = [facts["url"] for facts in self.server.status.transports if "url" in facts]
        self.port = int(urls[0].rpartition(":")[2])

    async def stop(self) -> None:
        await self._stack.aclose()

    @asynccontextmanager
    async def _open(self, _config: NoOptions, host: Host) -> AsyncGenerator[Robot]:
        await self.opens.wait()
        self.robots[host.tenant] = Robot(host)
        yield self.robots[host.tenant]

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()
