"""A real gateway around a small robot, spoken to in memory."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec

from configuration import backend, configuration, key
from rcp_gateway.client_api import ClientApi
from rcp_gateway.features import ActiveFeature, active
from rcp_gateway.log import configure
from rcp_gateway.plugins import Plugins
from rcp_gateway.server import Prepared, Server, running
from rcp_gateway.testing import ScriptedRobot
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from rcp_kernel.config.file import GatewayConfig, parse
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.features import FeatureKind
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, Host, Progress
from rcp_kernel.types import Twist, quantity
from rcp_kernel.values import Encoding
from rcp_store.store import Store

BOUND = 60.0  # s any wait of a test may take, on a machine that is busy otherwise


class NoOptions(msgspec.Struct):
    """The robot has nothing to configure."""


RESOURCES = (
    Resource(
        name="sensor/level", description="A level.", value=quantity("m"), live=True, deadline=0.2
    ),
    Resource(name="sensor/lazy", description="Published while watched.", value=quantity("m")),
    Resource(name="param/limit", description="A limit.", value=quantity("m/s", ge=0, le=2.5)),
    Resource(
        name="actuator/drive",
        description="A drive.",
        value=Twist,
        valid_for=0.1,
        safe=Twist(),
        max_age=1.0,
    ),
    Resource(
        name="action/go",
        description="Goes.",
        input=quantity("m"),
        output=quantity("m"),
        feedback=quantity("m"),
    ),
    Resource(
        name="action/wait_in_line", description="Queues.", input=quantity("1"), policy="queue"
    ),
    Resource(name="action/cut_in", description="Preempts.", input=quantity("1"), policy="preempt"),
    Resource(name="service/echo", description="Answers.", input=str, output=str),
)


MOVES = ("go", "wait_in_line", "cut_in")


class Robot(ScriptedRobot):
    """The robot of the kernel's tests: its actions do as the number says that they are given."""

    def __init__(self, host: Host) -> None:
        super().__init__(host, values={"param/limit": 1.5})
        self.behaviours |= dict.fromkeys((f"action/{n}" for n in MOVES), self.go)
        self.behaviours["service/echo"] = echo
        self.lazy["sensor/lazy"] = 7.0

    def declare(self) -> None:
        """Put the robot's resources into the tree."""
        self.add(*RESOURCES)

    async def go(self, value: Any, progress: Progress) -> Any:
        """Go on until released, unless the number says something else."""
        match value:
            case 13:
                raise DeviceRejected("thirteen brings bad luck")
            case 14:
                progress(1.0)
                raise DeviceRejected("stumbled")
            case 15:
                raise ZeroDivisionError("a bug")
            case 16:
                progress(1.0)
                raise ConnectionError("cut")
            case 17:
                raise ConnectionError("cut")
            case _:
                progress(value / 2, fraction=0.5)
                return await self.wait(value, progress)


async def echo(value: Any, progress: Progress) -> Any:
    """Answer with what was asked."""
    return value


class Client:
    """A client in memory: sends envelopes as JSON, sorts what comes back."""

    def __init__(self, client_api: ClientApi, token: str | None = None) -> None:
        self.inbox: list[dict[str, Any]] = []
        self._arrived = asyncio.Event()
        self.connection = client_api.connect(
            client_api.authenticate(token), Encoding.JSON, self._flush
        )
        self._count = 0

    def _flush(self) -> None:
        self.inbox += [json.loads(data) for data in self.connection.outbox.collect()]
        self.connection.outbox.again()
        self._arrived.set()

    def send(self, **envelope: Any) -> str:
        """Send a request; return its id."""
        self._count += 1
        envelope.setdefault("id", f"c-{self._count}")
        self.connection.receive(json.dumps(envelope).encode())
        return envelope["id"]

    async def until(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Take the first message out of the inbox for which `wanted` holds."""
        async with asyncio.timeout(BOUND):
            while True:
                for message in self.inbox:
                    if wanted(message):
                        self.inbox.remove(message)
                        return message
                self._arrived.clear()
                await self._arrived.wait()

    async def final(self, id_: str) -> dict[str, Any]:
        """Wait for the final reply to a request."""
        ends = ("completed", "failed", "rejected", "cancelled")
        return await self.until(lambda m: m.get("id") == id_ and m.get("status") in ends)

    async def ask(self, **envelope: Any) -> dict[str, Any]:
        """Send a request and wait for its final reply."""
        return await self.final(self.send(**envelope))

    async def update(self, id_: str) -> dict[str, Any]:
        """Wait for the next update of a subscription."""
        return await self.until(lambda m: m["type"] == "update" and m["id"] == id_)

    async def notice(self, code: str) -> dict[str, Any]:
        """Wait for a notice."""
        return await self.until(lambda m: m["type"] == "notice" and m["code"] == code)


class World:
    """A gateway, its robot, and clients of it."""

    def __init__(self, server: Server, robots: list[Robot]) -> None:
        self.server = server
        self.robots = robots

    @property
    def robot(self) -> Robot:
        """The robot's present life."""
        return self.robots[-1]

    def client(self, token: str | None = "operator-operator") -> Client:
        """Connect a client."""
        return Client(self.server.client_api, token)


CONFIG = configuration(
    backend(), key("operator", "operator-operator"), key("admin", "admin-admin-admin")
)


def kept_in(path: Path, text: str = CONFIG) -> str:
    """Add a store to a configuration."""
    return f'{text}\n[store]\npath = "{path}"\n'


async def settled(store: Store) -> None:
    """Wait until all that was put is committed."""
    done = asyncio.Event()
    store.settled(done.set)
    async with asyncio.timeout(BOUND):
        await done.wait()


async def until_trouble(store: Store) -> str:
    """Wait until a store cannot write; return why."""
    async with asyncio.timeout(BOUND):
        while store.trouble is None:  # noqa: ASYNC110 - the store tells nobody
            await asyncio.sleep(0.005)
    return store.trouble


def prepared(
    config: GatewayConfig, robots: list[Robot], make: Callable[[Host], Robot] = Robot
) -> Prepared:
    """Prepare a gateway whose only plugin is the robot of these tests."""

    @asynccontextmanager
    async def open_robot(_config: NoOptions, host: Host) -> AsyncGenerator[Robot]:
        robot = make(host)
        robots.append(robot)
        robot.declare()
        yield robot

    kind = BackendKind("robot", NoOptions, open_robot)
    plugins: Any = SimpleNamespace(
        backends={"robot": kind},
        transports={},
        adapters={},
        missing=[],
        points={"plugins": {}},
        is_missing=lambda _group, _name: None,
    )
    tables = tuple(NoOptions() for _ in config.backends)
    return Prepared(config, plugins, tables, {}, {}, features_of(config))


@cache
def _built_in() -> dict[str, FeatureKind]:
    return Plugins(GatewayConfig()).features


def features_of(config: GatewayConfig) -> tuple[ActiveFeature, ...]:
    """Prepare the built-in features that a configuration has."""
    return active(config, _built_in(), "test")


@asynccontextmanager
async def world_of(
    text: str = CONFIG,
    make: Callable[[Host], Robot] = Robot,
    clock: Clock = SYSTEM_CLOCK,
) -> AsyncGenerator[World]:
    """Run a gateway of a configuration around the robot."""
    robots: list[Robot] = []
    recent = configure("warning", "json")
    async with running(prepared(parse(text, "test"), robots, make), recent, clock=clock) as server:
        yield World(server, robots)
