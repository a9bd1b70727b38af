"""A backend is told who asked for the operation that it carries out, and nobody for its own."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from kernel.world import BOUND, Robot, World, world_of
from rcp_kernel.spi import Caller, Progress, caller

pytestmark = pytest.mark.anyio
GO, LIMIT, DRIVE = "/tenant/alpha/action/go", "/tenant/alpha/param/limit", "/actuator/drive"


class Asking(Robot):
    """Asks who commands it."""

    def __init__(self, host: Any) -> None:
        super().__init__(host)
        self.heard: asyncio.Queue[tuple[str, Caller | None]] = asyncio.Queue()

    def ask(self, what: str) -> None:
        self.heard.put_nowait((what, caller()))

    async def read(self, name: str) -> Any:
        self.ask("read")
        return await super().read(name)

    async def write(self, name: str, value: Any) -> Any:
        self.ask("write")
        return await super().write(name, value)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        self.ask("execute")
        try:
            return await super().execute(name, value, progress)
        except asyncio.CancelledError:
            self.ask("cancelled")
            raise

    @asynccontextmanager
    async def watch(self, name: str, rate: float | None) -> AsyncGenerator[None]:
        self.ask("watch")
        yield

    async def halt(self) -> None:
        self.ask("halt")
        await super().halt()


@pytest.fixture
async def asking() -> AsyncGenerator[World]:
    async with world_of(make=Asking) as world:
        yield world


async def told(world: World, what: str) -> Caller | None:
    """Return whom the robot was told of in the next call of a kind."""
    assert isinstance(world.robot, Asking)
    async with asyncio.timeout(BOUND):
        while True:
            kind, found = await world.robot.heard.get()
            if kind == what:
                return found


@pytest.mark.parametrize(
    ("what", "request_"),
    [
        ("read", {"type": "read", "path": LIMIT, "body": {"fresh": True}}),
        ("write", {"type": "write", "path": LIMIT, "body": 1.0, "idempotency_key": "k"}),
        ("execute", {"type": "execute", "path": GO, "body": 3.0, "idempotency_key": "k"}),
    ],
)
async def test_the_person_the_key_and_the_deadline_are_told(
    asking: World, what: str, request_: dict[str, Any]
) -> None:
    loop = asyncio.get_running_loop()
    begun = loop.time()
    asking.robot.release.set()
    client = asking.client()
    reply = await client.ask(**request_, deadline=9)
    assert reply["status"] == "completed"
    found = await told(asking, what)
    assert found is not None
    assert (found.principal.name, found.principal.proof) == ("operator", "key")
    assert found.idempotency_key == request_.get("idempotency_key")
    assert begun + 9 <= found.deadline <= loop.time() + 10
    assert found.command == reply.get("command")


async def test_each_is_told_his_own_also_of_a_queue_and_while_it_is_cancelled(
    asking: World,
) -> None:
    operator, admin = asking.client(), asking.client("admin-admin-admin")
    path = "/tenant/alpha/action/wait_in_line"
    first = operator.send(type="execute", path=path, body=1)
    await told(asking, "execute")
    second = admin.send(type="execute", path=path, body=2)
    await admin.until(lambda m: m["id"] == second and m["status"] == "pending")
    admin.send(type="cancel", path=path, command=await _command(operator, first))
    cancelled, following = await told(asking, "cancelled"), await told(asking, "execute")
    assert cancelled is not None
    assert following is not None
    assert cancelled.principal.name == "operator"
    assert following.principal.name == "admin"


async def _command(client: Any, id_: str) -> str:
    reply = await client.until(lambda m: m["id"] == id_ and "command" in m)
    return str(reply["command"])


async def test_stops_the_dead_man_and_streams_are_nobodys(asking: World) -> None:
    client = asking.client()
    subscribed = client.send(type="subscribe", path="/sensor/lazy")
    assert (await client.final(subscribed))["status"] == "completed"
    assert await told(asking, "watch") is None
    await client.ask(type="write", path=DRIVE, body={"linear": {"x": 1.0}, "angular": {}})
    assert await told(asking, "write") is not None
    assert await told(asking, "write") is None  # the safe value, when the first one has lapsed
    await client.ask(type="execute", path="/system/estop", body={"reason": "test"})
    assert await told(asking, "halt") is None
