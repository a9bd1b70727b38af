"""An e-stop holds what it was meant for, also what appears later, until somebody may reset it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest

from configuration import backend, configuration, key, role, rule
from kernel.world import BOUND, Client, World, kept_in, prepared, settled, world_of
from rcp_gateway.reload import apply
from rcp_kernel.config.file import parse

pytestmark = pytest.mark.anyio
HEAD = configuration(
    key("admin", "admin-admin-admin"),
    key("operator", "operator-operator", tenants=["alpha"]),
    key("chief", "chief-chief-chief", role="admin", tenants=["alpha"]),
    key("guest", "guest-guest-guest", tenants=["alpha"]),
) + role("guest", rule("read", "/sensor/r1/**"), rule("execute", "/system/estop"))
ADMIN, CHIEF, GUEST = "admin-admin-admin", "chief-chief-chief", "guest-guest-guest"


FLEET = (
    HEAD
    + backend("r1", "alpha", robot="r1")
    + backend("r2", "alpha", robot="r2")
    + backend("r3", "beta", robot="r3")
)


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    async with world_of(FLEET) as made:
        yield made


async def estop(client: Client, **body: Any) -> dict[str, Any]:
    return await client.ask(type="execute", path="/system/estop", body=body)


async def moves(client: Client, name: str, tenant: str = "alpha") -> bool:
    """Tell whether a robot takes commands; one that does not must say that an e-stop is why."""
    reply = await client.ask(
        type="write", path=f"/tenant/{tenant}/actuator/{name}/drive", body={}, deadline=BOUND
    )
    assert reply["status"] == "completed" or reply["error"]["code"] == "estop_active"
    return reply["status"] == "completed"


async def test_a_stop_of_one_robot_holds_that_robot_alone(world: World) -> None:
    admin = world.client(ADMIN)
    for scope in ("r1", "/tenant/alpha/r1", "/tenant/alpha/actuator/r1/drive"):
        state = (await estop(admin, scope=scope))["body"]
        assert set(state["robots"]) == {"r1"}
        assert not await moves(admin, "r1")
        assert await moves(admin, "r2")
        assert (await estop(admin, scope=scope, reset=True))["body"]["active"] is False
        assert await moves(admin, "r1")


async def test_a_stop_without_a_scope_holds_what_the_principal_may_see(world: World) -> None:
    operator, admin = world.client(), world.client(ADMIN)
    state = (await estop(operator, reason="smoke"))["body"]
    assert set(state["robots"]) == {"r1", "r2"}
    assert set(state["scopes"]) == {"/tenant/alpha"}
    assert await moves(admin, "r3", "beta")
    guest = world.client(GUEST)
    await estop(admin, reset=True)
    assert set((await estop(guest))["body"]["robots"]) == {"r1"}
    assert (await admin.ask(type="read", path="/system/estop"))["body"]["scopes"] == {}
    assert await moves(admin, "r2")


async def test_a_reset_of_one_robot_leaves_the_rest_of_its_tenant_latched(world: World) -> None:
    admin = world.client(ADMIN)
    await estop(admin, scope="/tenant/alpha")
    await estop(admin, scope="r1", reset=True)
    assert await moves(admin, "r1")
    assert not await moves(admin, "r2")
    await estop(admin, scope="/tenant/alpha")
    assert not await moves(admin, "r1")
    await estop(admin, scope="/tenant/alpha", reset=True)
    assert await moves(admin, "r1")
    assert await moves(admin, "r2")


async def test_a_tenant_is_freed_from_a_stop_of_the_gateway_without_the_others(
    world: World,
) -> None:
    admin, chief = world.client(ADMIN), world.client(CHIEF)
    state = (await estop(admin))["body"]
    assert set(state["scopes"]) == {"*"}
    assert (await estop(chief, reset=True))["status"] == "completed"
    assert await moves(chief, "r1")
    assert not await moves(admin, "r3", "beta")


async def test_who_resets_needs_the_right_for_every_robot_in_scope(world: World) -> None:
    operator, chief, admin = world.client(), world.client(CHIEF), world.client(ADMIN)
    await estop(admin)
    refused = await estop(operator, reset=True)
    assert refused["error"]["code"] == "forbidden"
    unseen = await estop(chief, scope="/tenant/beta", reset=True)
    assert unseen["error"]["code"] == "unknown_path"
    assert not await moves(admin, "r1")


async def test_a_robot_that_appears_in_a_stopped_tenant_is_stopped_too(world: World) -> None:
    admin = world.client(ADMIN)
    await estop(admin, scope="/tenant/alpha")
    before = parse(FLEET, "test")
    after = parse(
        FLEET + backend("r4", "alpha", robot="r4") + backend("r5", "beta", robot="r5"), "test"
    )
    await apply(world.server, prepared(after, world.robots))
    assert len(after.backends) == len(before.backends) + 2
    async with asyncio.timeout(BOUND):
        for supervisor in world.server.supervisors:
            await supervisor.settled.wait()
    assert not await moves(admin, "r4")
    assert await moves(admin, "r5", "beta")
    assert (await estop(admin, scope="r4", reset=True))["status"] == "completed"
    assert await moves(admin, "r4")
    assert not await moves(admin, "r1")


async def test_a_latch_outlives_the_gateway(tmp_path: Path) -> None:
    text = kept_in(tmp_path / "rcp.db", FLEET)
    async with world_of(text) as world:
        admin = world.client(ADMIN)
        await estop(admin, scope="/tenant/alpha", reason="smoke")
        await estop(admin, scope="r2", reset=True)
        await settled(world.server.gateway.store)
    async with world_of(text) as world:
        admin = world.client(ADMIN)
        state = (await admin.ask(type="read", path="/system/estop"))["body"]
        assert state["robots"]["r1"]["reason"] == "smoke"
        assert not await moves(admin, "r1")
        assert await moves(admin, "r2")
        assert world.robots[0].halts >= 1
        await estop(admin, reset=True)
        assert await moves(admin, "r1")
        await settled(world.server.gateway.store)
    async with world_of(text) as world:
        assert await moves(world.client(ADMIN), "r1")


async def test_what_was_sent_before_a_stop_does_not_run_after_its_reset(world: World) -> None:
    admin = world.client(ADMIN)
    drive = "/tenant/alpha/actuator/r1/drive"
    queued = "/tenant/alpha/action/r1/wait_in_line"
    running = admin.send(type="execute", path=queued, body=1)
    waiting = admin.send(type="execute", path=queued, body=2)
    writes = [
        admin.send(type="write", path=drive, body={"linear": {"x": 1.0}}, valid_for=100)
        for _ in range(3)
    ]
    stop = admin.send(type="execute", path="/system/estop", body={})
    reset = admin.send(type="execute", path="/system/estop", body={"reset": True})
    assert (await admin.final(reset))["status"] == "completed"
    assert (await admin.final(stop))["status"] == "completed"
    for id_ in writes:
        assert (await admin.final(id_))["error"]["code"] == "estop_active"
    for id_ in (running, waiting):
        assert (await admin.final(id_))["status"] == "cancelled"
    assert all(robot.writes == [] for robot in world.robots)
