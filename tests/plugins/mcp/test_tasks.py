"""Tasks: a long action under the id of its command, for clients that take them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest

from plugins.mcp.rig import BOUND, Caller, Site, caller, site

TASKS: dict[str, Any] = {"extensions": {"io.modelcontextprotocol/tasks": {}}}


class Client(Caller):
    """Names the task in the header, as the extension wants it."""

    async def task(self, method: str, id_: str) -> dict[str, Any]:
        self.http.headers["mcp-name"] = id_
        try:
            return await self.send(f"tasks/{method}", taskId=id_)
        finally:
            del self.http.headers["mcp-name"]

    async def state(self, id_: str) -> dict[str, Any]:
        answer = await self.task("get", id_)
        assert "result" in answer, answer
        return answer["result"]

    async def ended(self, id_: str) -> dict[str, Any]:
        async with asyncio.timeout(BOUND):
            while (found := await self.state(id_))["status"] == "working":  # noqa: ASYNC110 - polled
                await asyncio.sleep(0.02)
        return found


@pytest.fixture
async def client(gateway: Site) -> AsyncGenerator[Client]:
    made = Client(gateway.url, **TASKS)
    yield made
    await made.http.aclose()


async def test_an_action_is_a_task_with_its_result(gateway: Site, client: Client) -> None:
    made = await client.call("action-go", x=3)
    assert made["resultType"] == "task"
    assert made["status"] == "working"
    assert isinstance(made["ttlMs"], int)
    assert (await client.state(made["taskId"]))["status"] == "working"
    gateway.robot.release.set()
    ended = await client.ended(made["taskId"])
    assert ended["status"] == "completed"
    assert ended["result"]["structuredContent"]["result"] == {"x": 3, "y": 0}


async def test_a_refusal_of_the_robot_is_a_result_that_is_an_error(client: Client) -> None:
    made = await client.call("action-go", x=9)
    ended = await client.ended(made["taskId"])
    assert ended["status"] == "completed"
    assert ended["result"]["isError"] is True


async def test_what_is_refused_at_once_or_short_makes_no_task(client: Client) -> None:
    assert (await client.call("action-go", x=99))["isError"] is True
    assert (await client.call("service-double", value=2))["resultType"] == "complete"
    assert (await client.call("action-go", x=1, dry_run=True))["resultType"] == "complete"


async def test_cancelling_a_task_stops_the_robot(gateway: Site, client: Client) -> None:
    made = await client.call("action-go", x=3)
    answer = await client.task("cancel", made["taskId"])
    assert answer["result"]["resultType"] == "complete"
    assert (await client.ended(made["taskId"]))["status"] == "cancelled"
    assert gateway.robot.stopped.qsize()
    assert "result" in await client.task("cancel", made["taskId"])


async def test_tasks_are_their_callers_alone_and_of_clients_that_take_them(
    gateway: Site, client: Client, operator: Caller
) -> None:
    made = await client.call("action-go", x=3)
    other = Client(gateway.url, None, **TASKS)
    assert (await other.task("get", made["taskId"]))["error"]["code"] == -32602
    await other.http.aclose()
    assert (await client.task("get", "cmd-0"))["error"]["code"] == -32602
    plain = Client(gateway.url)
    assert (await plain.task("get", made["taskId"]))["error"]["code"] == -32021
    await plain.http.aclose()
    mismatch = await client.send("tasks/get", taskId=made["taskId"])
    assert mismatch["error"]["code"] == -32020


async def test_a_restart_leaves_a_task_failed_with_the_reason(tmp_path: Path) -> None:
    kept = f'[store]\npath = "{tmp_path}/store.db"\n'
    async with site(more=kept) as made:
        first = Client(made.url, **TASKS)
        id_ = (await first.call("action-go", x=3))["taskId"]
        await first.http.aclose()
        # As after a power cut: nothing of the command's end is kept.
        made.server.gateway.journal.keep = lambda _command: None  # type: ignore[method-assign]
    async with site(more=kept) as made:
        second = Client(made.url, **TASKS)
        found = await second.state(id_)
        assert found["status"] == "failed"
        assert "the gateway stopped while the command was running" in found["error"]["message"]
        reply = await second.call("status", command=id_)
        assert reply["structuredContent"]["command"]["status"] == "failed"
        await second.http.aclose()


async def test_who_takes_no_tasks_waits_for_the_result(gateway: Site) -> None:
    gateway.robot.release.set()
    async with caller(gateway) as plain:
        assert (await plain.call("action-go", x=1))["resultType"] == "complete"
