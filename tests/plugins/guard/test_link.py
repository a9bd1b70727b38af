"""The gateway's side of the guard: who is armed, when, and which robots nothing would stop."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from kernel.world import CONFIG, Client, Robot, World, world_of
from rcp_gateway.testing import SteppedClock
from rcp_kernel.spi import MotionState, StopPlan, Watchdog

pytestmark = pytest.mark.anyio
START = 120  # s until a guard process has started, on a machine that does much else


async def report(client: Client) -> dict[str, Any]:
    return (await client.ask(type="status"))["body"]


async def until_armed(client: Client, *, armed: bool) -> None:
    async with asyncio.timeout(START):
        while (await report(client))["guard"]["armed"] is not armed:  # noqa: ASYNC110
            await asyncio.sleep(0.02)


async def test_a_command_arms_before_it_runs_and_rest_disarms(
    world: World, stepped: SteppedClock
) -> None:
    client = world.client()
    assert (await report(client))["guard"]["armed"] is False
    go = client.send(type="execute", path="/action/go", body=1)
    await world.robot.started.get()
    assert world.server.status.plain()["guard"][
        "armed"
    ]  # before the robot had it, not a beat later
    world.robot.release.set()
    await client.final(go)
    stepped.advance(5)
    await until_armed(client, armed=False)


async def test_what_moves_nothing_does_not_arm(world: World) -> None:
    client = world.client()
    await client.ask(type="execute", path="/service/echo", body="x")
    await client.ask(type="write", path="/param/limit", body=1.0)
    assert (await report(client))["guard"]["armed"] is False


async def test_a_robot_that_still_moves_after_its_command_stays_armed(
    world: World, stepped: SteppedClock
) -> None:
    moving = MotionState(at_rest=False)
    world.robot.motion = lambda _robot: moving  # type: ignore[method-assign]
    client = world.client()
    world.robot.release.set()
    await client.ask(type="execute", path="/action/go", body=1)
    for _ in range(3):  # longer than a robot lingers that is at rest
        stepped.advance(5)
        await client.ask(type="ping")
    assert (await report(client))["guard"]["armed"] is True
    moving = MotionState(at_rest=True)
    await until_armed(client, armed=False)


async def test_a_latched_robot_is_armed(world: World) -> None:
    client = world.client("admin-admin-admin")
    await client.ask(type="execute", path="/system/estop", body={})
    await until_armed(client, armed=True)
    await client.ask(type="execute", path="/system/estop", body={"reset": True})
    await until_armed(client, armed=False)


async def test_a_gateway_without_it_stops_robots_as_before() -> None:
    async with world_of(CONFIG + "\n[features]\nguard = false\n") as world:
        client = world.client("admin-admin-admin")
        found = await report(client)
        assert "guard" not in found
        go = client.send(type="execute", path="/action/go", body=1)
        await world.robot.started.get()
        await client.ask(type="execute", path="/system/estop", body={})
        assert (await client.final(go))["status"] == "cancelled"
        assert world.robot.halts


async def test_what_is_wrong_with_one_backend_ends_no_heartbeat() -> None:
    def make(host: Any) -> Robot:
        host.guard("good", StopPlan("udp", {"to": ["127.0.0.1", 9], "frames": []}))
        host.guard("bad", StopPlan("udp", {"frames": [b"bytes"]}))
        return Robot(host)

    async with world_of(make=make) as world:
        world.robot.motion = lambda _robot: 1 / 0  # type: ignore[method-assign,return-value]
        client = world.client()
        world.robot.release.set()
        await client.ask(type="execute", path="/action/go", body=1)
        async with asyncio.timeout(START):
            while (found := await report(client))["guard"]["state"] != "ready":  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        assert [plan["name"] for plan in found["guard"]["plans"]] == ["good"]
        assert "plan 'bad'" in found["backends"][0]["last_error"]
        await until_armed(client, armed=True)


async def test_it_is_not_ready_while_the_guard_has_the_plan_before(world: World) -> None:
    client = world.client()
    for port in (9, 10):
        world.robot.host.guard("stop", StopPlan("udp", {"to": ["127.0.0.1", port], "frames": []}))
        assert world.server.status.plain()["guard"]["state"] == "starting"
        async with asyncio.timeout(START):
            while (await report(client))["guard"]["state"] != "ready":  # noqa: ASYNC110
                await asyncio.sleep(0.02)


@pytest.mark.parametrize(
    ("watchdogs", "plan", "gateways", "warned"),
    [
        ([], False, False, True),
        ([Watchdog("a time-out", 0.5)], False, False, True),
        ([Watchdog("none", None, verified=True)], False, False, True),
        ([Watchdog("a time-out", 0.5, verified=True)], False, False, False),
        ([], True, False, False),
        ([], False, True, False),
    ],
)
async def test_a_robot_that_nothing_would_stop_is_a_warning_once(
    stepped: SteppedClock, watchdogs: list[Watchdog], *, plan: bool, gateways: bool, warned: bool
) -> None:
    def make(host: Any) -> Robot:
        robot = Robot(host)
        robot.watchdogs = lambda: watchdogs  # type: ignore[method-assign]
        robot.has_gateways = gateways
        if plan:
            data = {"to": ["127.0.0.1", 9], "frames": []}
            host.guard("stop", StopPlan("udp", data))
        return robot

    async with world_of(make=make, clock=stepped.clock) as world:
        client = world.client()
        for _ in range(3):  # of which the first heartbeat finds the backend ready
            stepped.advance(15)
            await client.ask(type="ping")
        found = await report(client)
        said = [r for r in found["warnings"] if r["message"] == "robot_without_watchdog"]
        assert len(said) == (1 if warned else 0)
        assert all("robot" not in one["facts"] for one in said)  # it has no name of its own
        assert [w["mechanism"] for w in found["guard"]["watchdogs"]] == [
            w.mechanism for w in watchdogs
        ]
