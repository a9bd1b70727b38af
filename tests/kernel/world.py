"""A real gateway around a small robot, spoken to in memory."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec

from rcp_kernel.app.features import ActiveFeature, active
from rcp_kernel.app.log import configure
from rcp_kernel.app.plugins import Plugins
from rcp_kernel.app.server import Prepared, Server, running
from rcp_kernel.client_api import ClientApi
from rcp_kernel.config.file import GatewayConfig, parse
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.features import FeatureKind
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host, Progress
from rcp_kernel.store.store import Store
from rcp_kernel.types import Twist, quantity
from rcp_kernel.values import Encoding

BOUND = 20.0  # s any wait of a test may take, on a machine that is busy otherwise


class NoOptions(msgspec.Struct):
    """The robot has nothing to configure."""


class Robot(BaseBackend):
    """A robot whose every reaction a test decides."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.writes: list[tuple[str, Any]] = []
        self.halts = 0
        self.watched: list[tuple[str, float | None]] = []
        self.left: list[tuple[str, float | None]] = []
        self.release = asyncio.Event()
        self.started: asyncio.Queue[Any] = asyncio.Queue()
        self.stopped = 0
        self.fail_writes = 0
        self.fail_halts = 0

    def declare(self) -> None:
        """Put the robot's resources into the tree."""
        self.host.declare(
            Resource(
                name="sensor/level",
                description="A level.",
                value=quantity("m"),
                live=True,
                deadline=0.2,
            ),
            Resource(
                name="sensor/lazy", description="Published while watched.", value=quantity("m")
            ),
            Resource(
                name="param/limit", description="A limit.", value=quantity("m/s", ge=0, le=2.5)
            ),
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
                name="action/wait_in_line",
                description="Queues.",
                input=quantity("1"),
                policy="queue",
            ),
            Resource(
                name="action/cut_in", description="Preempts.", input=quantity("1"), policy="preempt"
            ),
            Resource(name="service/echo", description="Answers.", input=str, output=str),
        )

    async def read(self, name: str) -> Any:
        if name == "param/limit":
            return 1.5
        return await super().read(name)

    async def write(self, name: str, value: Any) -> Any:
        if self.fail_writes:
            self.fail_writes -= 1
            raise DeviceRejected("busy")
        self.writes.append((name, value))

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        if name == "service/echo":
            return value
        self.started.put_nowait(value)
        try:
            if value == 13:
                raise DeviceRejected("thirteen brings bad luck")
            if value == 14:
                progress(1.0)
                raise DeviceRejected("stumbled")
            if value == 15:
                raise ZeroDivisionError("a bug")
            progress(value / 2, fraction=0.5)
            await self.release.wait()
        except asyncio.CancelledError:
            self.stopped += 1
            raise
        return value if name == "action/go" else None

    @asynccontextmanager
    async def watch(self, name: str, rate: float | None) -> AsyncIterator[None]:
        self.watched.append((name, rate))
        if name == "sensor/lazy":
            self.host.publish(name, 7.0)
        yield
        self.left.append((name, rate))

    async def halt(self) -> None:
        self.halts += 1
        if self.fail_halts:
            self.fail_halts -= 1
            raise DeviceRejected("did not hear")


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


CONFIG = """
[transports]
asgi = false
http = false
ws = false
sse = false

[[backends]]
use = "robot"
tenant = "alpha"

[[keys]]
name = "operator"
role = "operator"
key = "operator-operator"

[[keys]]
name = "admin"
role = "admin"
key = "admin-admin-admin"
"""


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
    text: str = CONFIG, make: Callable[[Host], Robot] = Robot
) -> AsyncGenerator[World]:
    """Run a gateway of a configuration around the robot."""
    robots: list[Robot] = []
    recent = configure("warning", "json")
    async with running(prepared(parse(text, "test"), robots, make), recent) as server:
        yield World(server, robots)
