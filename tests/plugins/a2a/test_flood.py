"""What is long over A2A: no more is told or taken at once than may be."""

from __future__ import annotations

from pathlib import Path

import pytest
from a2a.types.a2a_pb2 import ListTasksRequest

from plugins.a2a.agent import agent, caller, data, rpc, sent, text
from plugins.a2a.test_runs import state
from plugins.a2a.test_tasks import DONE, called_by, kept, made
from rcp_kernel.model import Resource
from transports.robot import Site

pytestmark = pytest.mark.anyio


async def test_a_message_of_too_many_values_is_refused() -> None:
    async with agent() as site, caller(site) as client:
        answer = await client.post("/a2a/message:send", json=data({"steps": [1] * 1100}))
        assert answer.status_code == 413
        assert "1024 values" in answer.json()["error"]["message"]


def _declare(site: Site, numbers: int) -> None:
    host = site.robot.host
    host.declare(Resource(name="sensor/long", description="Long.", value=list[int], live=True))
    host.publish("sensor/long", [7] * numbers)


async def test_a_result_of_many_values_is_told_as_json_in_a_text() -> None:
    async with agent() as site, caller(site) as client:
        _declare(site, 3000)
        task = await sent(client, text("read /sensor/long"))
        part = task["artifacts"][0]["parts"][0]
        assert part["mediaType"] == "application/json"
        assert part["text"].count("7,") == 2999
        _, other = (await sent(client, text("read /sensor/pose\nread /sensor/pose")))["artifacts"]
        assert "data" in other["parts"][0]


async def test_of_a_long_task_the_latest_messages_are_told() -> None:
    async with agent() as site, caller(site) as client:
        _declare(site, 1)
        task = await sent(client, text("read /sensor/long\n" * 60))
        assert state(task) == "COMPLETED"
        told = (await rpc(client, "GetTask", id=task["id"]))["result"]
        assert len(told["history"]) == 64
        assert (await rpc(client, "GetTask", id=task["id"], historyLength=3))["result"]["history"]


async def test_a_page_of_tasks_ends_where_it_would_be_too_long(tmp_path: Path) -> None:
    ada = called_by("ada")
    async with kept(tmp_path) as tasks:
        for age in range(5):
            task = made(f"t-{age}", DONE, age=age)
            task.metadata["x"] = "x" * 40_000
            await tasks.save(task, ada)
        found: list[str] = []
        pages, token = 0, ""
        while token or not pages:
            page = await tasks.list(ListTasksRequest(page_token=token), ada)
            found += [task.id for task in page.tasks]
            assert (page.total_size, page.ByteSize() < 100_000) == (5, True)
            pages, token = pages + 1, page.next_page_token
        assert (found, pages) == ([f"t-{age}" for age in range(5)], 3)


async def test_a_task_that_is_longer_than_a_page_is_told_all_the_same(tmp_path: Path) -> None:
    ada = called_by("ada")
    async with kept(tmp_path) as tasks:
        task = made("long", DONE)
        task.metadata["x"] = "x" * 200_000
        await tasks.save(task, ada)
        page = await tasks.list(ListTasksRequest(), ada)
        assert [task.id for task in page.tasks] == ["long"]
        assert not page.next_page_token


async def test_tasks_that_wait_for_ever_are_not_gathered_without_end() -> None:
    async with agent("tasks = 2") as site, caller(site) as client:
        for _ in range(2):
            waits = await sent(client, text("execute /service/add"))
            assert state(waits) == "INPUT_REQUIRED"
        refused = await rpc(client, "SendMessage", **text("read /sensor/pose"))
        assert "answer or cancel some of them first" in refused["error"]["message"]
        stop = await sent(client, text("execute /system/estop"))
        assert state(stop) == "COMPLETED"
        await rpc(client, "CancelTask", id=waits["id"])
        assert state(await sent(client, text("read /sensor/pose"))) == "COMPLETED"
