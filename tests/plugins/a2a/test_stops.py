"""Stopping and holding over A2A: a task is completed only when the robots are at rest."""

from __future__ import annotations

import json

import pytest

from plugins.a2a.agent import agent, caller, data, rpc, sent, text
from plugins.a2a.test_runs import said, state
from transports.robot import until

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


STOPS = [
    text("execute /system/estop"),
    data({"steps": [{"do": "execute", "path": "/system/estop"}]}),
    text("execute /service/hold\nexecute /tenant/alpha/service/hold"),
]
NO_STOPS = [
    text("execute /system/estop\nexecute /action/go 1"),
    data({"steps": [{"do": "execute", "path": "/system/estop", "when": "true"}]}),
    text("read /sensor/pose"),
]


async def test_no_rate_keeps_anybody_from_a_stop() -> None:
    top = "[quotas]\nprincipal = { requests = 0.01, burst = 1 }"
    async with agent(top=top) as site, caller(site) as client:
        await client.get("/a2a/tasks")
        for stop in STOPS:
            assert state(await sent(client, stop)) == "COMPLETED"
        for other in NO_STOPS:
            assert (await client.post("/a2a/message:send", json=other)).status_code == 429


@pytest.mark.parametrize(
    "top", ["[quotas]\nprincipal = { plans = 1, commands = 1 }", "[plans]\nrunning = 1"]
)
async def test_no_number_of_plans_keeps_anybody_from_a_stop(top: str) -> None:
    async with agent(top=top) as site, caller(site) as client:
        wait = {"do": "wait", "until": "false", "deadline": 60}
        begun = {"returnImmediately": True}
        await sent(client, data({"steps": [wait]}, configuration=begun))
        await until(lambda: site.server.gateway.commands.running)
        assert "queue_full" in json.dumps(await sent(client, text("read /sensor/pose")))
        assert state(await sent(client, text("execute /service/hold"))) == "COMPLETED"


async def test_no_quota_keeps_anybody_from_cancelling_a_task() -> None:
    top = "[quotas]\nprincipal = { requests = 0.01, burst = 3 }"
    async with agent(top=top) as site, caller(site) as client:
        begun = {"returnImmediately": True}
        task = await sent(client, text("execute /action/go 1", configuration=begun))
        await site.robot.started.get()  # what it sends is counted, too
        while (await client.get(f"/a2a/tasks/{task['id']}")).status_code == 200:
            pass
        answer = await client.post(f"/a2a/tasks/{task['id']}:cancel", json={})
        assert (answer.status_code, state(answer.json())) == (200, "CANCELED")


async def test_a_robot_is_held_without_a_latch() -> None:
    async with agent() as site, caller(site) as client:
        task = await sent(client, text("execute /service/hold"))
        assert state(task) == "COMPLETED"
        reply = await client.get("/rcp/v1/context/system/estop")
        assert reply.json()["body"]["active"] is False


async def test_a_stop_that_nobody_confirms_fails_and_names_the_robot() -> None:
    async with agent() as site, caller(site) as client:
        site.robot.lose("no heartbeat for 4 s")
        task = await sent(client, text('execute /system/estop {"scope": "/tenant/alpha"}'))
        assert state(task) == "FAILED"
        written = json.dumps(task)
        assert "device_timeout" in written
        assert "not confirmed at rest" in written
        assert "no heartbeat" in written
        assert "carried out" not in said(task)
