"""What one stop stops: a robot behind several backends, a group, a tenant, all that one may."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest

from configuration import backend, key, role, rule, table
from kernel.motion.test_latches import HEAD, moves
from kernel.safety.scripted import ADMIN, ESTOP, estop
from kernel.world import World, world_of
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError

pytestmark = pytest.mark.anyio
FLEET = (
    HEAD
    + key("cell", "cell-cell-cell-cell", tenants=["alpha", "beta"])
    + role("cell", rule("*", "/**"), rule("read execute", "/system/estop"), stop_all=False)
    + table("safety.groups", pair=["/tenant/alpha/r1", "/tenant/beta/r3"])
    + backend("r1", "alpha", robot="r1")
    + backend("r2", "alpha", robot="r2")
    + backend("r3", "beta", robot="r3")
)


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    async with world_of(FLEET) as made:
        yield made


async def test_a_group_is_stopped_and_reset_by_its_name(world: World) -> None:
    admin = world.client(ADMIN)
    assert (await admin.ask(type="read", path=ESTOP))["body"]["groups"] == ["pair"]
    answer = await estop(admin, scope="pair")
    assert set(answer["body"]["robots"]) == {"r1", "r3"}
    assert await moves(admin, "r2")
    assert not await moves(admin, "r3", "beta")
    assert (await estop(admin, scope="pair", reset=True))["body"]["active"] is False
    assert await moves(admin, "r1")


async def test_a_group_is_those_of_its_robots_that_one_may_see(world: World) -> None:
    operator = world.client()
    assert (await operator.ask(type="read", path=ESTOP))["body"]["groups"] == ["pair"]
    assert set((await estop(operator, scope="pair"))["body"]["robots"]) == {"r1"}
    assert await moves(world.client(ADMIN), "r3", "beta")


async def test_without_the_right_to_stop_all_a_stop_is_of_the_own_tenant(world: World) -> None:
    cell = world.client("cell-cell-cell-cell")
    answer = await estop(cell)
    if answer["status"] == "completed":
        assert set(answer["body"]["scopes"]) == {"/tenant/alpha"}
    else:  # a session of several tenants has none of its own
        assert answer["error"]["code"] == "forbidden"
        assert "scope" in answer["error"]["remedy"]
    assert await moves(world.client(ADMIN), "r3", "beta")
    assert (await estop(cell, scope="/tenant/beta"))["status"] == "completed"


def test_a_group_names_scopes_and_no_backend() -> None:
    for wrong in ('cell = ["alpha"]', 'r1 = ["/tenant/alpha"]', 'cell = ["/tenant/nowhere"]'):
        with pytest.raises(ConfigError, match=r"\[safety.groups\]"):
            parse(HEAD + backend("r1", "alpha", robot="r1") + f"[safety.groups]\n{wrong}\n", "test")
