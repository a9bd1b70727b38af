"""Nothing changes faster than an envelope says, whoever wrote before."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from kernel.fenced import (
    AGENT,
    GENTLE,
    OPERATOR,
    Clock,
    code,
    drive,
    fenced,
    twist,
)
from rcp_kernel.errors import DeviceRejected, DeviceTimeout

pytestmark = pytest.mark.anyio


async def test_a_change_takes_its_time(clock: Clock) -> None:
    async with fenced(GENTLE, clock.clock) as world:
        client = world.client(AGENT)
        refusal = await drive(client, 0.5)
        assert refusal["error"]["code"] == "out_of_range"
        assert "changes too fast: from 0.0 to 0.5 at 1 m/s/s at most" in refusal["error"]["message"]
        clock.now += 0.5
        assert code(await drive(client, 0.5)) == "completed"
        clock.now += 0.25
        refusal = await drive(client, -0.5)
        assert refusal["error"]["details"]["allowed"] == {"min": 0.25, "max": 0.75}
        assert code(await drive(client, 0.25)) == "completed"


async def test_a_long_pause_is_no_licence_for_a_jump(clock: Clock) -> None:
    async with fenced(
        GENTLE.replace("/actuator/drive", "/actuator/raw")
        .replace("linear.x", "")
        .replace('"angular.z" = { max = 1 }', "")
        .replace("5 }, ", "5 } "),
        clock.clock,
    ) as world:
        client = world.client(AGENT)
        assert code(await client.ask(type="write", path="/actuator/raw", body=0.0)) == "completed"
        clock.now += 3600
        assert (
            code(await client.ask(type="write", path="/actuator/raw", body=1.5)) == "out_of_range"
        )
        assert code(await client.ask(type="write", path="/actuator/raw", body=1.0)) == "completed"


async def test_a_change_is_measured_from_whoever_wrote_last(clock: Clock) -> None:
    async with fenced(GENTLE, clock.clock) as world:
        assert code(await drive(world.client(OPERATOR), 3.0)) == "completed"
        clock.now += 0.5
        agent = world.client(AGENT)
        assert code(await drive(agent, 0.5)) == "out_of_range"
        assert code(await drive(agent, 2.5)) == "completed"


async def test_after_a_stop_a_change_is_measured_from_the_safe_value(clock: Clock) -> None:
    async with fenced(GENTLE, clock.clock) as world:
        agent, admin = world.client(AGENT), world.client("admin-admin-admin")
        assert code(await drive(world.client(OPERATOR), 3.0)) == "completed"
        assert code(await admin.ask(type="execute", path="/system/estop", body={})) == "completed"
        await admin.ask(type="execute", path="/system/estop", body={"reset": True})
        clock.now += 0.5
        assert code(await drive(agent, 3.0)) == "out_of_range"
        assert code(await drive(agent, 0.5)) == "completed"


async def test_after_the_dead_man_a_change_is_measured_from_the_safe_value(clock: Clock) -> None:
    async with fenced(GENTLE, clock.clock) as world:
        watcher = world.client(OPERATOR)
        id_ = watcher.send(type="subscribe", path="/actuator/drive")
        assert code(await drive(world.client(OPERATOR), 3.0, valid_for=0.05)) == "completed"
        await watcher.until(
            lambda m: m["type"] == "update" and m["id"] == id_ and m["body"]["linear"]["x"] == 0.0
        )
        clock.now += 0.5
        assert code(await drive(world.client(AGENT), 3.0)) == "out_of_range"
        assert code(await drive(world.client(AGENT), 0.5)) == "completed"


async def test_writes_that_are_under_way_count_already(clock: Clock) -> None:
    async with fenced(GENTLE, clock.clock) as world:
        answered, robot = asyncio.Event(), world.robot

        async def write(name: str, value: Any) -> None:
            robot.writes.append((name, value))
            await answered.wait()

        robot.write = write
        client = world.client(AGENT)
        clock.now += 1.0
        first = client.send(type="write", path="/actuator/drive", body=twist(0.9))
        assert code(await drive(client, -0.9)) == "out_of_range"
        answered.set()
        assert code(await client.final(first)) == "completed"


async def test_a_write_that_the_robot_refused_changed_nothing(clock: Clock) -> None:
    async with fenced(
        GENTLE.replace("drive", "raw")
        .replace("linear.x", "")
        .replace('"angular.z" = { max = 1 }', "")
        .replace("5 }, ", "5 } "),
        clock.clock,
    ) as world:
        client, robot = world.client(AGENT), world.robot
        outcomes: list[Exception | None] = [None, DeviceRejected("no"), DeviceTimeout("?"), None]

        async def write(_name: str, _value: Any) -> None:
            if (error := outcomes.pop(0)) is not None:
                raise error

        robot.write = write

        async def to(value: float) -> str:
            clock.now += 1.0
            return code(await client.ask(type="write", path="/actuator/raw", body=value))

        assert await to(0.0) == "completed"
        assert await to(1.0) == "device_rejected"
        assert await to(-1.0) == "device_timeout"
        assert await to(0.5) == "out_of_range"  # it may be at -1 by now
        assert await to(-0.5) == "completed"


async def test_the_first_value_of_a_path_without_a_safe_one_is_free(clock: Clock) -> None:
    table = '[[envelopes]]\nname = "e"\npaths = ["/actuator/speeds"]\nrate = { "*" = 1.0 }\n'
    async with fenced(table, clock.clock) as world:
        client = world.client()
        for body, wanted in [
            ([5.0, -5.0], "completed"),
            ([5.5, -5.5], "completed"),
            ([5.5], "out_of_range"),
            ([5.5, -5.5, 0.0], "out_of_range"),
            ([5.5, -4.0], "out_of_range"),
        ]:
            reply = await client.ask(type="write", path="/actuator/speeds", body=body)
            assert code(reply) == wanted, body
            clock.now += 0.5
