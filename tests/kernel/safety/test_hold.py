"""`service/hold` brings a robot to rest without an e-stop, for whoever may execute it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator

import pytest

from kernel.motion.test_latches import GUEST
from kernel.safety.scripted import (
    ADMIN,
    DRIVE,
    ESTOP,
    FAST,
    GO,
    HOLD,
    estop,
    scripted,
    scripted_world,
)
from kernel.world import BOUND, World
from rcp_kernel.spi import MotionState

pytestmark = pytest.mark.anyio


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    async with scripted_world() as made:
        yield made


async def test_it_ends_what_moves_the_robot_and_latches_nothing(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    await admin.ask(type="write", path=DRIVE, body=FAST, valid_for=0.2)
    go = admin.send(type="execute", path=GO, body=1)
    async with asyncio.timeout(BOUND):
        await robot.started.get()
    held = await world.client().ask(type="execute", path=HOLD)
    assert (held["status"], held["body"]) == ("completed", {"at_rest": True, "detail": ""})
    final = await admin.final(go)
    assert (final["status"], "commanded to hold" in final["error"]["message"]) == (
        "cancelled",
        True,
    )
    assert robot.sent.count("hold") == 2, "what a cancelled action sends last could come after it"
    assert robot.sent[-1] == "hold"
    assert (await admin.ask(type="read", path=ESTOP))["body"]["active"] is False
    write = await admin.ask(type="write", path=DRIVE, body=FAST, valid_for=BOUND)
    assert write["status"] == "completed"


async def test_a_hold_and_its_end_are_changes_of_the_robots_state(world: World) -> None:
    robot, operator = scripted(world), world.client()
    unit = world.server.supervisors[0].whole
    held: list[bool] = []
    world.server.gateway.registry.on_state.append(lambda: held.append(unit.is_held))
    robot.rests.clear()
    hold = operator.send(type="execute", path=HOLD)
    async with asyncio.timeout(BOUND):
        await robot.holding.wait()
    assert held == [True]
    robot.rests.set()
    assert (await operator.final(hold))["status"] == "completed"
    assert held == [True, False]


async def test_nothing_moves_a_robot_that_is_being_brought_to_rest(world: World) -> None:
    robot, admin, operator = scripted(world), world.client(ADMIN), world.client()
    robot.rests.clear()
    hold = operator.send(type="execute", path=HOLD)
    async with asyncio.timeout(BOUND):
        await robot.holding.wait()
    write = await admin.ask(type="write", path=DRIVE, body=FAST)
    assert write["error"]["code"] == "already_running"
    assert "being brought to rest" in write["error"]["message"]
    assert (await admin.ask(type="execute", path=GO, body=1))["error"]["code"] == "already_running"
    assert (await admin.ask(type="write", path=DRIVE, body={}))["status"] == "completed"
    assert (await admin.ask(type="execute", path=HOLD, dry_run=True))["status"] == "completed"
    robot.rests.set()
    assert (await operator.final(hold))["status"] == "completed"
    write = await admin.ask(type="write", path=DRIVE, body=FAST, valid_for=BOUND)
    assert write["status"] == "completed"


async def test_a_robot_that_moves_on_is_not_said_to_hold(world: World) -> None:
    scripted(world).state = MotionState(at_rest=False, detail="it moves at 2 m/s")
    held = await world.client().ask(type="execute", path=HOLD)
    assert (held["status"], held["error"]["code"]) == ("failed", "device_timeout")
    assert held["error"]["retryable"] is True  # a repeat brings it to rest, nothing else
    assert "it moves at 2 m/s" in held["error"]["message"]


async def test_neither_lease_nor_latch_refuses_it(world: World) -> None:
    robot, admin, operator = scripted(world), world.client(ADMIN), world.client()
    lease = {"do": "acquire", "scope": "/tenant/alpha/r1"}
    assert (await admin.ask(type="execute", path="/system/leases", body=lease))["status"] == (
        "completed"
    )
    write = await operator.ask(type="write", path=DRIVE, body=FAST)
    assert write["error"]["code"] == "lease_held"
    assert (await operator.ask(type="execute", path=HOLD))["status"] == "completed"
    await estop(admin)
    assert (await operator.ask(type="execute", path=HOLD))["status"] == "completed"
    assert robot.sent.count("hold") == 2


async def test_it_needs_the_right_to_execute_it(world: World) -> None:
    held = await world.client(GUEST).ask(type="execute", path=HOLD)
    assert held["error"]["code"] in ("forbidden", "unknown_path")
    assert scripted(world).sent == []


async def test_a_dry_run_holds_nothing(world: World) -> None:
    held = await world.client().ask(type="execute", path=HOLD, dry_run=True)
    assert held["status"] == "completed"
    assert held["dry_run"] is True
    assert scripted(world).sent == []


async def test_it_is_there_for_as_long_as_something_moves(world: World) -> None:
    admin, host = world.client(ADMIN), scripted(world).host
    moving = ["actuator/drive", "action/go", "action/wait_in_line", "action/cut_in", "service/dock"]
    host.withdraw(*moving[1:])
    assert (await admin.ask(type="execute", path=HOLD))["status"] == "completed"
    host.withdraw(moving[0])
    assert (await admin.ask(type="execute", path=HOLD))["error"]["code"] == "unknown_path"


async def test_a_gateway_without_a_link_does_not_say_that_it_holds(world: World) -> None:
    robot = scripted(world)
    robot.lost = "the link is cut"
    held = await world.client().ask(type="execute", path=HOLD)
    assert (held["status"], held["error"]["code"]) == ("failed", "adapter_unavailable")
    robot.lost = ""  # a gateway that ends waits for its robots
