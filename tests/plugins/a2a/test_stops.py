"""Stopping and holding over A2A: a task is completed only when the robots are at rest."""

from __future__ import annotations

import json

import pytest

from plugins.a2a.agent import agent, caller, rpc, sent, text
from plugins.a2a.test_runs import said, state
from rcp_kernel.errors import AdapterUnavailable

pytestmark = pytest.mark.anyio


async def test_the_card_says_how_robots_are_stopped_and_held() -> None:
    async with agent() as site, caller(site) as client:
        card = (await rpc(client, "GetExtendedAgentCard"))["result"]
        skills = {skill["id"]: skill for skill in card["skills"]}
        assert all(word in skills["stop"]["description"] for word in ("group", "tenant", "robot"))
        assert [id_ for id_ in skills if "hold" in id_] == ["service.hold"]
        task = await sent(client, text(skills["stop"]["examples"][1]))
        assert state(task) == "COMPLETED"
        (artifact,) = task["artifacts"]
        robots = artifact["parts"][0]["data"]["result"]["robots"]
        assert {one["state"] for one in robots.values()} == {"confirmed"}


async def test_a_robot_is_held_without_a_latch() -> None:
    async with agent() as site, caller(site) as client:
        task = await sent(client, text("execute /service/hold"))
        assert state(task) == "COMPLETED"
        told = await client.get("/rcp/v1/context/system/estop")
        assert told.json()["body"]["active"] is False


async def test_a_stop_that_nobody_confirms_fails_and_names_the_robot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with agent() as site, caller(site) as client:

        async def unreachable() -> None:
            raise AdapterUnavailable("no heartbeat for 4 s")

        monkeypatch.setattr(site.robot, "halt", unreachable)
        task = await sent(client, text('execute /system/estop {"scope": "/tenant/alpha"}'))
        assert state(task) == "FAILED"
        written = json.dumps(task)
        assert "device_timeout" in written
        assert "not confirmed at rest" in written
        assert "no heartbeat" in written
        assert "carried out" not in said(task)
