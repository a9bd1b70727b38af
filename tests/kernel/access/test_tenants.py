"""Tenants share nothing: what one does is no news to the other."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Any

import pytest
import structlog

from configuration import backend, configuration, key, table
from kernel.world import Client, World, world_of
from rcp_kernel.contract.peer import Peer
from rcp_kernel.model import Resource
from rcp_kernel.types import quantity
from rcp_kernel.values import Encoding

pytestmark = pytest.mark.anyio
ALPHA, BETA, ALL = "alpha-alpha-alpha", "beta-beta-beta-beta", "all-all-all-all-all"
CONFIG = configuration(
    backend("rover"),
    backend("drone", "beta"),
    key("ann", ALPHA, roles={"alpha": "admin"}),
    key("ann", BETA, roles={"beta": "admin"}),
    key("boss", ALL, role="admin"),
)


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    """Two tenants with a robot each, and administrators of one name in both."""
    async with world_of(CONFIG) as made:
        yield made


async def body(client: Client, path: str) -> Any:
    reply = await client.ask(type="read", path=path)
    assert reply["status"] == "completed", reply
    return reply["body"]


async def test_the_health_report_is_of_the_own_tenants(world: World) -> None:
    alpha, beta, boss = (world.client(token) for token in (ALPHA, BETA, ALL))
    await beta.ask(type="subscribe", path="/sensor/*")
    await beta.ask(type="execute", path="/service/echo", body="x")
    mine, whole = await body(alpha, "/system/status"), await body(boss, "/system/status")
    assert [robot["name"] for robot in mine["backends"]] == ["rover"]
    assert (mine["sessions"], mine["subscriptions"]) == (2, 0)  # the boss's paths mean alpha
    assert mine["commands"]["completed"] == 0
    assert whole["commands"]["completed"] == 1
    assert (whole["sessions"], whole["subscriptions"]) == (3, 1)
    assert mine["resources"] < whole["resources"]
    assert "process" in whole
    assert "process" not in mine
    assert "drone" not in str(mine)
    assert "beta" not in str(mine)


async def test_sessions_are_those_of_the_own_tenants(world: World) -> None:
    alpha, _, boss = (world.client(token) for token in (ALPHA, BETA, ALL))
    assert {s["tenant"] for s in await body(alpha, "/system/sessions")} == {"alpha"}
    assert {s["tenant"] for s in await body(boss, "/system/sessions")} == {"alpha", "beta"}


async def test_who_has_proved_nothing_does_not_see_where_others_are() -> None:
    async with world_of(CONFIG + table("anonymous", role="operator")) as world:
        api = world.server.client_api
        for token in (None, ALPHA):
            principal = api.authenticate(token)
            api.connect(principal, Encoding.JSON, lambda: None, peer=Peer(address="192.0.2.7"))
        stranger = await body(world.client(None), "/system/sessions")
        assert len(stranger) == 2
        assert {s["address"] for s in stranger} == {None}
        ann = await body(world.client(ALPHA), "/system/sessions")
        assert "192.0.2.7" in {s["address"] for s in ann}


async def test_log_records_are_of_the_own_tenants(world: World) -> None:
    alpha, boss = world.client(ALPHA), world.client(ALL)
    for client in (alpha, boss):
        await client.ask(type="subscribe", id="log", path="/system/log", body={"qos": {"depth": 9}})
    log = structlog.get_logger("test")
    log.warning("of nobody", detail="the gateway's own")
    log.warning("of beta", path="/tenant/beta/sensor/level")
    log.warning("of beta", backend="drone")
    log.warning("of alpha", backend="rover")
    seen = [(await boss.update("log"))["body"] for _ in range(4)]
    assert [record["tenant"] for record in seen] == [None, "beta", "beta", "alpha"]
    assert (await alpha.update("log"))["body"]["message"] == "of alpha"
    assert not [m for m in alpha.inbox if m["type"] == "update"]
    assert (await body(alpha, "/system/log"))["tenant"] == "alpha"
    warnings = (await body(alpha, "/system/status"))["warnings"]
    assert {record["message"] for record in warnings} == {"of alpha"}


async def test_an_idempotency_key_of_one_tenant_is_free_in_another(world: World) -> None:
    alpha, beta = world.client(ALPHA), world.client(BETA)
    first = await alpha.ask(
        type="execute", path="/service/echo", body="a", idempotency_key="k", id="same"
    )
    other = await beta.ask(
        type="execute", path="/service/echo", body="b", idempotency_key="k", id="same"
    )
    assert (first["body"], other["body"]) == ("a", "b")


async def test_the_generation_of_the_tree_is_what_one_sees_of_it(world: World) -> None:
    alpha, beta = world.client(ALPHA), world.client(BETA)

    async def generations() -> list[int]:
        replies = [await c.ask(type="discover") for c in (alpha, beta)]
        return [reply["body"]["generation"] for reply in replies]

    before = await generations()
    supervisor = next(
        supervisor for supervisor in world.server.supervisors if supervisor.tenant == "beta"
    )
    supervisor.declare(Resource(name="sensor/new", description="New.", value=quantity("m")))
    after = await generations()
    assert after[0] == before[0]
    assert after[1] > before[1]


async def test_an_emergency_stop_is_seen_in_its_own_tenant(world: World) -> None:
    alpha, beta = world.client(ALPHA), world.client(BETA)
    await beta.ask(type="execute", path="/system/estop", body={"reason": "a test"})
    assert (await body(beta, "/system/estop"))["active"]
    state = await body(alpha, "/system/estop")
    assert not state["active"]
    assert not state["robots"]
    assert not state["scopes"]
    refused = await alpha.ask(type="execute", path="/system/estop", body={"scope": "drone"})
    unknown = await alpha.ask(type="execute", path="/system/estop", body={"scope": "nobody"})
    assert refused["error"]["code"] == unknown["error"]["code"] == "unknown_path"


async def test_commands_and_leases_of_another_tenant_are_not_there(world: World) -> None:
    alpha, beta = world.client(ALPHA), world.client(BETA)
    done = await beta.ask(type="execute", path="/service/echo", body="x")
    await beta.ask(
        type="execute", path="/system/leases", body={"do": "acquire", "scope": "/actuator"}
    )
    assert await body(alpha, "/system/commands") == []
    assert await body(alpha, "/system/leases") == []
    theirs = (await alpha.ask(type="cancel", command=done["command"]))["error"]
    none = (await alpha.ask(type="cancel", command="cmd-0000000000000000"))["error"]
    for error in (theirs, none):
        error.pop("trace_id", None)
    assert str(theirs).replace(done["command"], "X") == str(none).replace(
        "cmd-0000000000000000", "X"
    )
