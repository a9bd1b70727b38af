"""A backend whose robots have gateways of their own, which go on without this one."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from kernel.motion.test_latches import estop
from kernel.world import CONFIG, Client, Robot, World, kept_in, world_of
from rcp_kernel.clock import Clock, now
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress, caller
from rcp_kernel.types import quantity

pytestmark = pytest.mark.anyio
GO = "/tenant/alpha/action/r1/go"


class Far:
    """What is beyond the link: the robot's own gateway, which knows each command by its key."""

    def __init__(self) -> None:
        self.begun: list[str] = []
        self.asked: asyncio.Queue[str] = asyncio.Queue()
        self.who: list[str] = []
        self.cancelled: list[str] = []
        self.done = asyncio.Event()
        self.halts = 0
        self.written: asyncio.Queue[tuple[float, float | None]] = asyncio.Queue()
        self.refuses = False
        self.released: list[tuple[str | None, str]] = []


class Near(Robot):
    """This end of it."""

    has_gateways = True
    on_loss = "continue"
    far: Far

    def declare(self) -> None:
        self.closing = False
        self.add(
            Resource(
                name="action/r1/go",
                robot="r1",
                description="Goes.",
                input=quantity("1"),
                output=quantity("1"),
            ),
            *(
                Resource(
                    name=f"actuator/r1/{name}",
                    robot="r1",
                    description="Drives.",
                    value=quantity("m/s"),
                    valid_for=0.02,
                    safe=0.0,
                    atomic="wheels",
                )
                for name in ("left", "right")
            ),
        )

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        who = caller()
        assert who is not None
        assert who.command is not None
        if who.command not in self.far.begun:
            self.far.begun.append(who.command)
        self.far.who.append(who.principal.name)
        self.far.asked.put_nowait(who.command)
        try:
            await self.far.done.wait()
        except asyncio.CancelledError:
            self.far.cancelled.append(who.command)
            raise
        return value

    async def write(self, name: str, value: Any) -> Any:
        who = caller()
        self.far.written.put_nowait((value, None if who is None else who.valid_for))

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        for name, value in values.items():
            await self.write(name, value)
        return {}

    async def halt(self) -> None:
        self.far.halts += 1

    async def halt_robot(self, robot: str) -> None:
        self.far.halts += 1

    async def reset_estop(self, robot: str | None) -> None:
        who = caller()
        assert who is not None
        self.far.released.append((robot, who.principal.name))
        if self.far.refuses:
            raise DeviceRejected("a person is in the cell")


@pytest.fixture
def far(monkeypatch: pytest.MonkeyPatch) -> Far:
    made = Far()
    monkeypatch.setattr(Near, "far", made, raising=False)
    return made


async def begin(world: World, far: Far, **fields: Any) -> tuple[Client, str, str]:
    """Send a command; return the client, the request's id and the command's."""
    client = world.client()
    id_ = client.send(type="execute", path=GO, body=1, **fields)
    return client, id_, await far.asked.get()


async def test_closing_neither_halts_nor_cancels_and_the_next_run_takes_it_up(
    far: Far, tmp_path: Path
) -> None:
    config = kept_in(tmp_path / "store.db")
    async with world_of(config, Near) as world:
        _, _, command = await begin(world, far, idempotency_key="mine")
    assert far.halts == 0
    cancelled, far.cancelled = far.cancelled, []
    assert cancelled in ([], [command])  # after the backend was closed: nobody is told
    async with world_of(config, Near) as world:
        assert await far.asked.get() == command
        assert far.who == ["operator", "operator"]
        client = world.client()
        again = client.send(type="execute", path=GO, body=1, idempotency_key="mine")
        first = await client.until(lambda m: m["id"] == again)
        assert (first["command"], first["status"]) == (command, "accepted")
        far.done.set()
        final = await client.final(again)
        assert (final["status"], final["body"], final["command"]) == ("completed", 1.0, command)
    assert far.begun == [command]
    async with world_of(config, Near) as world:
        listed = (await world.client().ask(type="read", path="/system/commands"))["body"]
        assert [one["status"] for one in listed] == ["completed"]


async def test_a_robot_that_is_down_does_not_end_its_command(far: Far) -> None:
    async with world_of(CONFIG, Near) as world:
        client, id_, _ = await begin(world, far)
        host = world.robot.host
        host.report("no link", down=True, robot="r1")
        host.report("no router", down=True)
        host.report(None)
        refused = await client.ask(type="execute", path=GO, body=2)
        assert refused["error"]["code"] == "adapter_unavailable"
        host.report(None, robot="r1")
        far.done.set()
        assert (await client.final(id_))["status"] == "completed"


async def test_its_deadline_ends_it_once(far: Far, tmp_path: Path) -> None:
    config = kept_in(tmp_path / "store.db")
    async with world_of(config, Near) as world:
        _, _, command = await begin(world, far, deadline=60)

    class Away(Near):
        def declare(self) -> None:
            """Nothing: the robot does not come back."""

    later = Clock(now=lambda: now() + 61 * 10**9)
    async with world_of(config, Away, later) as world:
        client = world.client()
        found: dict[str, Any] = {}
        while found.get("status") != "failed":
            [found] = (await client.ask(type="read", path="/system/commands"))["body"]
        assert found["command"] == command
        assert found["error"]["code"] == "deadline_exceeded"
        assert "could not be reached" in found["message"]


async def test_a_backend_that_is_opened_again_takes_its_commands_up(far: Far) -> None:
    async with world_of(CONFIG, Near) as world:
        client, id_, command = await begin(world, far)
        supervisor = world.server.supervisors[0]
        backend = supervisor.backend
        assert backend is not None
        commands = world.server.gateway.commands
        for task in commands.detach(supervisor.name):  # as a crash does
            task.cancel()
        busy = await client.ask(type="execute", path=GO, body=2)
        assert busy["error"]["code"] == "already_running"
        commands.take_up(supervisor.entries["action/r1/go"], backend)
        assert await far.asked.get() == command
        far.done.set()
        assert (await client.final(id_))["status"] == "completed"


async def test_a_command_of_a_latched_robot_is_not_taken_up(far: Far, tmp_path: Path) -> None:
    config = kept_in(tmp_path / "store.db")
    async with world_of(config, Near) as world:
        await begin(world, far)
    while not far.asked.empty():
        far.asked.get_nowait()

    class Later(Near):
        def declare(self) -> None:
            """Declare nothing yet."""

    async with world_of(config, Later) as world:
        admin = world.client("admin-admin-admin")
        stopping = admin.send(type="execute", path="/system/estop", body={})
        await admin.final(stopping)
        assert isinstance(world.robot, Later)
        Near.declare(world.robot)
        [found] = (await admin.ask(type="read", path="/system/commands"))["body"]
        assert found["status"] == "cancelled", found
        assert far.asked.empty()


async def test_a_reset_asks_the_robot_for_the_person_and_a_refusal_leaves_both_latched(
    far: Far,
) -> None:
    async with world_of(CONFIG, Near) as world:
        admin = world.client("admin-admin-admin")
        assert (await estop(admin, reason="smoke"))["status"] == "completed"
        far.refuses = True
        refused = await estop(admin, reset=True)
        assert refused["error"]["code"] == "device_rejected", refused
        assert "a person is in the cell" in refused["error"]["message"]
        state = (await admin.ask(type="read", path="/system/estop"))["body"]
        assert {n: one["reason"] for n, one in state["robots"].items()} == {"robot/r1": "smoke"}
        moved = await admin.ask(type="execute", path=GO, body=1)
        assert moved["error"]["code"] == "estop_active"
        far.refuses = False
        assert (await estop(admin, reset=True))["body"]["robots"] == {}
        assert far.released == [("r1", "admin"), ("r1", "admin")]


async def test_the_dead_man_is_the_robots_own(far: Far) -> None:
    left, right = (f"/tenant/alpha/actuator/r1/{name}" for name in ("left", "right"))
    async with world_of(CONFIG, Near) as world:
        client = world.client()
        alone = await client.ask(type="write", path=left, body=1.0, valid_for=0.03)
        both = await client.ask(type="write", body={left: 2.0, right: 3.0}, valid_for=0.04)
        assert (alone["status"], both["status"]) == ("completed", "completed")
        assert not world.server.gateway.deadman.driving
    assert [far.written.get_nowait() for _ in range(3)] == [(1.0, 0.03), (2.0, 0.04), (3.0, 0.04)]
    assert far.written.empty()
