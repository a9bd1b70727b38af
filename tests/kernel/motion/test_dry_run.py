"""A dry run passes every check and changes nothing at all."""

from __future__ import annotations

from typing import Any

import pytest

from kernel.fenced import (
    AGENT,
    EDGE,
    GENTLE,
    OPERATOR,
    Clock,
    code,
    drive,
    fenced,
    goal,
)
from kernel.world import Client

pytestmark = pytest.mark.anyio


async def test_a_dry_run_lists_the_envelopes_and_changes_nothing(clock: Clock) -> None:
    async with fenced(GENTLE + EDGE, clock.clock) as world:
        client, kernel = world.client(AGENT), world.server.gateway
        world.robot.at(1)
        clock.now += 1.0
        samples = kernel.registry.entries["/tenant/alpha/actuator/drive"].seq
        for _ in range(3):
            reply = await drive(client, 0.9, dry_run=True, idempotency_key="k")
            assert reply["body"]["envelopes"] == [
                {"envelope": "slow", "reason": "people walk here"},
                {"envelope": "hall"},
            ]
        assert code(await drive(client, 1.1, dry_run=True)) == "out_of_range"
        go = {"type": "execute", "path": "/action/move", "body": goal(1), "dry_run": True}
        assert (await client.ask(**go))["body"]["envelopes"] == [{"envelope": "hall"}]
        batch = await client.ask(type="batch", body=[go | {"id": "x"}])
        assert batch["body"][0]["dry_run"] is True
        assert world.robot.writes == []
        assert not kernel.commands.running
        assert kernel.registry.entries["/tenant/alpha/actuator/drive"].seq == samples
        assert not kernel.deadman.driving
        assert code(await drive(client, 0.5, idempotency_key="k")) == "completed"


async def test_a_dry_run_of_an_estop_is_refused_as_the_real_one_and_stops_nothing() -> None:
    async with fenced("") as world:
        client, admin = world.client(OPERATOR), world.client("admin-admin-admin")

        async def stop(who: Client, **body: Any) -> str:
            envelope = {"type": "execute", "path": "/system/estop", "body": body}
            return code(await who.ask(**envelope, dry_run=True))

        assert await stop(client) == "completed"
        assert await stop(client, scope="nowhere") == "unknown_path"
        assert await stop(client, reset=True) == "forbidden"
        assert world.robot.halts == 0
        assert code(await drive(client, 0.1)) == "completed"
        await admin.ask(type="execute", path="/system/estop", body={})
        assert await stop(admin, reset=True) == "completed"
        assert code(await drive(client, 0.1)) == "estop_active"


async def test_a_dry_run_asks_for_leases_and_takes_none() -> None:
    async with fenced("") as world:
        anna, agent = world.client(OPERATOR), world.client(AGENT)
        lease = {"type": "execute", "path": "/system/leases"}
        take = {"do": "acquire", "scope": "/actuator/drive"}
        assert code(await agent.ask(**lease, body=take, dry_run=True)) == "completed"
        assert code(await drive(anna, 0.1)) == "completed"
        assert code(await anna.ask(**lease, body=take)) == "completed"
        assert code(await drive(agent, 0.1, dry_run=True)) == "lease_held"
        assert code(await agent.ask(**lease, body=take, dry_run=True)) == "lease_held"
