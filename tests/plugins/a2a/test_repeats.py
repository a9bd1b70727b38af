"""A repeated message returns the task that it made; the robot acts once."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import httpx
import pytest

from plugins.a2a.agent import agent, caller, data, rpc, sent, text
from plugins.a2a.test_runs import begun, ended, state, streamed
from transports.robot import Site

pytestmark = pytest.mark.anyio
GO = "execute /action/go 5"
ADD = "execute /service/add 1"
SENT = 1000  # messages that are repeated


def history(task: dict[str, Any]) -> list[str]:
    return [one["messageId"] for one in task["history"] if one["role"] == "ROLE_USER"]


async def test_of_a_thousand_repeated_messages_each_acts_once(
    gateway: Site, client: httpx.AsyncClient
) -> None:
    numbers = iter(range(SENT))

    async def repeat() -> None:
        for number in numbers:
            message = data({"steps": [{"do": "execute", "path": "/service/add", "value": number}]})
            first, second = await asyncio.gather(sent(client, message), sent(client, message))
            assert first == second
            assert state(first) == "COMPLETED"
            assert history(first) == [message["message"]["messageId"]]

    async with asyncio.TaskGroup() as group:
        for _ in range(4):
            group.create_task(repeat())
    assert sorted(value for _, value in gateway.robot.ran) == list(range(SENT))


async def test_a_repetition_after_a_reconnect_waits_for_the_same_task(gateway: Site) -> None:
    message = text(GO)
    async with caller(gateway) as client:
        id_ = await begun(client, gateway, message)
    async with caller(gateway) as client:
        again = await sent(client, message)  # returns at once, as asked
        assert (again["id"], state(again)) == (id_, "WORKING")
        del message["configuration"]
        waiting = asyncio.ensure_future(sent(client, message))
        async with streamed(client, "POST", "/a2a/message:stream", json=message) as stream:
            assert (await stream.until("WORKING"))["id"] == id_
            gateway.robot.release.set()
            await stream.until("COMPLETED")
        assert (await waiting)["id"] == id_
        async with streamed(client, "POST", "/a2a/message:stream", json=message) as stream:
            (only,) = await stream.rest()
            assert (only["task"]["id"], state(only["task"])) == (id_, "COMPLETED")
    assert len(gateway.robot.ran) == 1


async def test_a_repetition_after_a_restart_returns_the_task(tmp_path: Path) -> None:
    done, cut = text(ADD), text(GO)
    async with agent(folder=tmp_path) as site, caller(site) as client:
        first = await sent(client, done)
        id_ = await begun(client, site, cut)
    async with agent(folder=tmp_path) as site, caller(site) as client:
        assert await sent(client, done) == first
        again = await sent(client, cut)
        assert (again["id"], state(again)) == (id_, "FAILED")
        assert site.robot.ran == []


@pytest.mark.parametrize("restarts", [False, True])
async def test_the_robot_acts_once_although_the_task_was_dropped(
    tmp_path: Path, *, restarts: bool
) -> None:
    message = text(ADD)
    async with agent("tasks = 1", folder=tmp_path) as site, caller(site) as client:
        first = await sent(client, message)
        await sent(client, text("read /sensor/pose"))
        assert (await client.get(f"/a2a/tasks/{first['id']}")).status_code == 404
        if not restarts:
            again = await sent(client, message)
            assert (state(again), again["id"] != first["id"]) == ("COMPLETED", True)
            assert len(site.robot.ran) == 1
    if restarts:
        async with agent("tasks = 1", folder=tmp_path) as site, caller(site) as client:
            assert state(await sent(client, message)) == "COMPLETED"
            assert site.robot.ran == []


@pytest.mark.parametrize("more", ["", "{}"], ids=["another text", "other metadata"])
async def test_other_content_under_the_same_id_is_refused(
    gateway: Site, client: httpx.AsyncClient, more: str
) -> None:
    task = await sent(client, text(ADD, messageId="one"))
    other = text("execute /service/add 2" if not more else ADD, messageId="one")
    if more:
        other["metadata"] = {"dry_run": True}
    reply = await rpc(client, "SendMessage", **other)
    assert reply["error"]["code"] == -32602
    assert "id of its own" in reply["error"]["message"]
    assert (await client.post("/a2a/message:send", json=other)).status_code == 400
    assert len(gateway.robot.ran) == 1
    assert (await client.get(f"/a2a/tasks/{task['id']}")).json() == task


async def test_a_repeated_answer_is_taken_once(gateway: Site, client: httpx.AsyncClient) -> None:
    task = await sent(client, text("execute /service/add"))
    assert state(task) == "INPUT_REQUIRED"
    answer = data({"1": 4}, taskId=task["id"], messageId="answer")
    first, second = await asyncio.gather(sent(client, answer), sent(client, answer))
    assert (state(first), state(second)) == ("COMPLETED", "COMPLETED")
    third = (await rpc(client, "SendMessage", **answer))["result"]["task"]  # the other binding
    assert third["id"] == task["id"]
    assert history(third).count("answer") == 1
    assert len(gateway.robot.ran) == 1


async def test_a_refused_message_can_be_sent_again(
    gateway: Site, client: httpx.AsyncClient
) -> None:
    task = await begun(client, gateway, text(GO))
    late = text(ADD, taskId=task)
    for _ in range(2):
        assert "running" in (await rpc(client, "SendMessage", **late))["error"]["message"]
    gateway.robot.release.set()
    await ended(client, task)
    assert len(gateway.robot.ran) == 1


async def test_a_stop_is_never_taken_for_a_repetition(
    gateway: Site, client: httpx.AsyncClient
) -> None:
    message = text("execute /service/hold", messageId="stop")
    tasks = [(await sent(client, message))["id"] for _ in range(2)]
    assert len({*tasks}) == 2


async def test_ids_are_each_callers_own(gateway: Site, client: httpx.AsyncClient) -> None:
    message = text("execute /service/add 3", messageId="one")
    own = await sent(client, message)
    async with caller(gateway, "key-of-tenant-beta") as other:
        theirs = (await other.post("/a2a/beta/message:send", json=message)).json()["task"]
    assert theirs["id"] != own["id"]
    assert [len(robot.ran) for robot in gateway.robots] == [1, 1]


async def test_a_client_of_the_version_before_gets_the_same_task(gateway: Site) -> None:
    part = {"kind": "text", "text": ADD}
    message = {"kind": "message", "messageId": "m", "role": "user", "parts": [part]}
    call = {"jsonrpc": "2.0", "id": 1, "method": "message/send", "params": {"message": message}}
    async with caller(gateway) as client:
        del client.headers["A2A-Version"]
        first, second = [(await client.post("/a2a", json=call)).json()["result"] for _ in range(2)]
    assert first == second
    assert len(gateway.robot.ran) == 1
