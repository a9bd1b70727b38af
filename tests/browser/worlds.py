"""A gateway in this process whose robots tell whatever a test wants, at an address where another may follow it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import msgspec

from configuration import backend, key, listener, table
from rcp_gateway.log import configure
from rcp_gateway.testing import ScriptedRobot, Served, serve
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, Host

__all__ = [
    "KEY",
    "OTHER",
    "SPARE",
    "Silent",
    "Teller",
    "World",
    "line",
    "live",
    "world",
]

KEY = "a-key-of-the-one-who-looks-all-day"
OTHER = "a-key-of-somebody-else-on-a-tablet"
SPARE = "a-key-that-is-taken-out-of-service"


class Who(msgspec.Struct):
    """Which of the robots it is."""

    who: str


class Teller(ScriptedRobot):
    """A robot that has what a test declares, and tells what a test publishes or writes."""

    async def write(self, name: str, value: Any) -> Any:
        await super().write(name, value)
        self.host.publish(name, value)


class World:
    """The gateway, and its robots by name."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.robots: dict[str, Teller] = {}
        self.served: Served

    def publish(self, robot: str, name: str, value: Any, timestamp: int | None = None) -> None:
        """Have a robot tell a value."""
        self.robots[robot].host.publish(name, value, timestamp)


def live(name: str, **more: Any) -> Resource:
    """Describe what a robot tells by itself: any value at all."""
    return Resource(name=name, description="Whatever it is.", value=Any, live=True, **more)


@asynccontextmanager
async def world(
    robots: dict[str, tuple[str, list[Resource]]],
    port: int = 0,
    *,
    role: str = "admin",
    spare: bool = False,
    more: str = "",
    plugin: str = "",
    secret: str = KEY,
) -> AsyncGenerator[World]:
    """Run a gateway while entered; `robots` are their tenants and what they declare, by name."""
    made, there = World(""), asyncio.Event()

    @asynccontextmanager
    async def opened(asked: Who, host: Host) -> AsyncGenerator[Teller]:
        teller = Teller(host, *robots[asked.who][1])
        made.robots[asked.who] = teller
        if len(made.robots) == len(robots):
            there.set()
        yield teller

    configure("critical", "json")
    text = (
        listener(port)
        + table("plugins.dashboard")
        + plugin
        + table("anonymous", role=[])
        + key("wall", secret, role=role)
        + key("tablet", OTHER, role="admin")
        + (key("spare", SPARE, role="operator") if spare else "")
        + more
        + "".join(backend(n, tenant, use="teller", who=n) for n, (tenant, _) in robots.items())
    )
    async with serve(parse(text, "test"), BackendKind("teller", Who, opened)) as served:
        made.served = served
        made.url = next(f["url"] for f in served.server.status.transports if "url" in f)
        async with asyncio.timeout(60):
            await there.wait()
        yield made


class Silent:
    """A way to the gateway that may swallow all that is sent, and tell nobody: as to a machine that sleeps."""

    def __init__(self) -> None:
        self.url = ""
        self.opened = 0
        """Connections so far."""
        self._speaks = asyncio.Event()
        self._speaks.set()
        self._ways: set[asyncio.StreamWriter] = set()
        self._another = asyncio.Event()

    def mute(self) -> None:
        """Let nothing through any more; what stands goes on standing, and more may be opened."""
        self._speaks.clear()

    def speak(self) -> None:
        """Let those through that are opened from now on; what was there before stays dumb."""
        self._speaks = asyncio.Event()
        self._speaks.set()

    async def serve(
        self, port: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Pass on one connection."""
        self.opened += 1
        self._another.set()
        speaks = self._speaks
        self._ways.add(writer)
        upstream, onward = await asyncio.open_connection("127.0.0.1", port)
        self._ways.add(onward)
        ways = ((reader, onward), (upstream, writer))
        await asyncio.gather(*(self._pass(speaks, *way) for way in ways), return_exceptions=True)

    async def _pass(
        self, speaks: asyncio.Event, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        while data := await reader.read(65_536):
            await speaks.wait()
            writer.write(data)
            await writer.drain()
        writer.close()

    async def another(self) -> None:
        """Wait until one more connection is opened, within the bound."""
        self._another.clear()
        async with asyncio.timeout(60):
            await self._another.wait()

    def close(self) -> None:
        """End all that stands."""
        for writer in self._ways:
            writer.transport.abort()


@asynccontextmanager
async def line(url: str) -> AsyncGenerator[Silent]:
    """Put a way that may fall silent between a page and the gateway while entered."""
    made = Silent()
    port = int(url.rpartition(":")[2])
    tasks: set[asyncio.Task[None]] = set()

    def serve_one(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.ensure_future(made.serve(port, reader, writer))
        tasks.add(task)
        task.add_done_callback(tasks.discard)

    server = await asyncio.start_server(serve_one, "127.0.0.1", 0)
    made.url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    try:
        yield made
    finally:
        server.close()
        made.close()
        for task in list(tasks):
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
