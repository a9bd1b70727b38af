"""Nothing moves that was not asked to, and nothing goes on that should have stopped."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from configuration import backend
from kernel.world import BOUND, CONFIG, Client, World, prepared
from rcp_gateway.reload import apply
from rcp_kernel.config.file import parse
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.safety.deadman import REPLY_GRACE
from rcp_kernel.types import Twist
from rcp_requests import write

pytestmark = pytest.mark.anyio
FORWARD = {"linear": {"x": 1.0}}
ADMIN = "admin-admin-admin"
STOP = ("actuator/drive", Twist())


class Hanging:
    """Takes every write, and answers only those of the safe value."""

    def __init__(self, world: World) -> None:
        self.seen: asyncio.Queue[Any] = asyncio.Queue()
        world.robot.write = self.write

    async def write(self, _name: str, value: Any) -> None:
        self.seen.put_nowait(value)
        if value != Twist():
            await asyncio.Event().wait()

    async def next(self) -> Any:
        async with asyncio.timeout(BOUND):
            return await self.seen.get()


async def drive(client: Client, **fields: Any) -> dict[str, Any]:
    return await client.ask(type="write", path="/actuator/drive", body=FORWARD, **fields)


async def test_a_write_that_is_never_answered_lapses_all_the_same(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(write, "REPLY_GRACE", 0.05)
    robot = Hanging(world)
    client = world.client()
    client.send(type="write", path="/actuator/drive", body=FORWARD)
    assert await robot.next() != Twist()
    assert await robot.next() == Twist()


async def test_after_a_write_of_unknown_outcome_the_robot_is_stopped(world: World) -> None:
    robot = Hanging(world)
    reply = await drive(world.client(), deadline=0.05)
    assert reply["error"]["code"] == "deadline_exceeded"
    assert await robot.next() != Twist()
    assert await robot.next() == Twist()


@pytest.mark.parametrize("error", [ConnectionError("cut"), TimeoutError()])
async def test_a_write_that_loses_its_link_is_not_said_to_be_refused(
    world: World, error: Exception
) -> None:
    async def cut(_value: Any) -> None:
        world.robot.moving.add("actuator/drive")
        raise error

    world.robot.takes["actuator/drive"] = cut
    reply = await drive(world.client())
    assert (reply["status"], reply["error"]["code"]) == ("failed", "adapter_unavailable")
    assert reply["error"]["retryable"] is False


async def test_a_write_that_the_robot_refused_takes_no_other_ones_window(world: World) -> None:
    first, answered = asyncio.Event(), asyncio.Event()
    written: asyncio.Queue[Any] = asyncio.Queue()

    async def write(_name: str, value: Any) -> None:
        if not first.is_set():
            first.set()
            await answered.wait()
            raise DeviceRejected("too late")
        written.put_nowait(value)

    world.robot.write = write
    client = world.client()
    late = client.send(type="write", path="/actuator/drive", body=FORWARD)
    async with asyncio.timeout(BOUND):
        await first.wait()
        assert (await drive(client))["status"] == "completed"
        answered.set()
        assert (await client.final(late))["error"]["code"] == "device_rejected"
        assert await written.get() != Twist()
        assert await written.get() == Twist()


async def test_an_estop_cancels_a_write_that_is_under_way(world: World) -> None:
    robot = Hanging(world)
    client = world.client(ADMIN)
    id_ = client.send(type="write", path="/actuator/drive", body=FORWARD)
    await robot.next()
    await client.ask(type="execute", path="/system/estop", body={})
    assert (await client.final(id_))["error"]["code"] == "estop_active"


async def test_what_came_in_just_before_an_estop_does_not_begin_after_it(world: World) -> None:
    client = world.client(ADMIN)
    write = client.send(type="write", path="/actuator/drive", body=FORWARD)
    action = client.send(type="execute", path="/action/go", body=1.0)
    estop = client.send(type="execute", path="/system/estop", body={})
    assert (await client.final(estop))["status"] == "completed"
    for id_ in (write, action):
        reply = await client.final(id_)
        assert (reply["status"], reply["error"]["code"]) in [
            ("rejected", "estop_active"),
            ("cancelled", "cancelled"),
        ]
    assert ("actuator/drive", Twist()) in world.robot.writes or not world.robot.writes
    assert world.robot.started.empty()


async def test_a_gateway_that_is_closing_moves_nothing_any_more(world: World) -> None:
    world.server.gateway.shutdown.begun = True
    client = world.client()
    for request in (
        {"type": "write", "path": "/actuator/drive", "body": FORWARD},
        {"type": "execute", "path": "/action/go", "body": 1.0},
    ):
        assert (await client.ask(**request))["error"]["code"] == "adapter_unavailable"


async def test_a_backend_that_leaves_the_configuration_is_halted_first(world: World) -> None:
    robot, client = world.robot, world.client()
    id_ = client.send(type="execute", path="/action/go", body=1.0)
    await client.until(lambda m: m.get("status") == "in_progress")
    without = CONFIG.replace(backend(), "")
    await apply(world.server, prepared(parse(without, "test"), []))
    assert (robot.halts, robot.stopped.qsize()) == (1, 1)
    assert (await client.final(id_))["error"]["code"] == "adapter_unavailable"


async def test_a_command_in_the_queue_is_answered_within_its_deadline(world: World) -> None:
    client = world.client()
    first = client.send(type="execute", path="/action/wait_in_line", body=1)
    late = await client.ask(type="execute", path="/action/wait_in_line", body=2, deadline=0.05)
    assert (late["status"], late["error"]["code"]) == ("failed", "deadline_exceeded")
    world.robot.release.set()
    assert (await client.final(first))["status"] == "completed"
    report = (await client.ask(type="status"))["body"]
    assert report["commands"]["queued"] == 0


async def test_the_repeat_of_a_write_keeps_its_own_deadline(world: World) -> None:
    go_on = asyncio.Event()

    async def slow(_name: str, _value: Any) -> None:
        await go_on.wait()

    world.robot.write = slow
    client = world.client()
    envelope = {"type": "write", "path": "/param/limit", "body": 1.0, "idempotency_key": "k"}
    first = client.send(**envelope)
    repeat = await client.ask(**envelope, deadline=0.05)
    assert repeat["error"]["code"] == "deadline_exceeded"
    go_on.set()
    assert (await client.final(first))["status"] == "completed"


def test_the_window_of_an_unanswered_write_is_bounded() -> None:
    assert REPLY_GRACE <= 1.0
