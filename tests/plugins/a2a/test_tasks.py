"""Tasks are kept within bounds, and a restart neither loses them nor leaves them hanging."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from a2a.server.context import ServerCallContext
from a2a.types.a2a_pb2 import ListTasksRequest, Task, TaskState, TaskStatus

from plugins.a2a.agent import agent, caller, sent, text
from plugins.a2a.receiver import receiver
from rcp_a2a.callers import CALLER, Caller
from rcp_a2a.config import A2aConfig
from rcp_a2a.tasks import Tasks
from rcp_kernel.access.acl import Rights
from rcp_kernel.clock import SYSTEM_CLOCK, now
from rcp_kernel.contract.identity import Principal
from rcp_kernel.sessions.session import Session
from rcp_store.disk_store import DiskStore
from rcp_store.plugin_store import PluginStore

pytestmark = pytest.mark.anyio
NOWHERE = "execute /service/nowhere"


@asynccontextmanager
async def kept(path: Path, **config: Any) -> AsyncGenerator[Tasks]:
    async with rows(path) as store:
        tasks = Tasks(store, A2aConfig(**config))
        tasks.restore(lambda _task: False)
        yield tasks


@asynccontextmanager
async def rows(path: Path) -> AsyncGenerator[PluginStore]:
    store = DiskStore(path / "store.db", asyncio.get_running_loop())
    try:
        yield PluginStore(store, "a2a.tasks")
    finally:
        await asyncio.sleep(0)  # the loop's turn hands over what was put
        store.close()


def called_by(name: str, tenant: str = "alpha") -> ServerCallContext:
    session = Session(
        Principal(name, (("*", ())), "key"), Rights((), {}), tenant, "a2a", clock=SYSTEM_CLOCK
    )
    return ServerCallContext(state={CALLER: Caller(session, "http://here")})


def made(id_: str, state: TaskState, age: float = 0.0) -> Task:
    status = TaskStatus(state=state)
    status.timestamp.FromNanoseconds(now() - int(age * 1e9))
    return Task(id=id_, context_id="c", status=status)


DONE, WORKING = TaskState.TASK_STATE_COMPLETED, TaskState.TASK_STATE_WORKING


async def test_a_task_outlives_its_process(tmp_path: Path) -> None:
    ada = called_by("ada")
    async with kept(tmp_path) as tasks:
        await tasks.save(made("t", DONE), ada)
    async with kept(tmp_path) as tasks:
        found = await tasks.get("t", ada)
        assert found is not None
        assert found.status.state == DONE


@pytest.mark.parametrize("state", [WORKING, TaskState.TASK_STATE_INPUT_REQUIRED])
async def test_a_task_in_mid_course_has_failed_after_a_restart(
    tmp_path: Path, state: TaskState
) -> None:
    ada = called_by("ada")
    async with kept(tmp_path) as tasks:
        await tasks.save(made("t", state), ada)
    for _ in range(2):  # and stays so
        async with kept(tmp_path) as tasks:
            found = await tasks.get("t", ada)
            assert found is not None
            assert found.status.state == TaskState.TASK_STATE_FAILED
            assert "restarted" in found.status.message.parts[0].text


async def test_a_task_is_its_owners_alone_after_a_restart_too(tmp_path: Path) -> None:
    async with kept(tmp_path) as tasks:
        await tasks.save(made("t", DONE), called_by("ada"))
    async with kept(tmp_path) as tasks:
        for other in (called_by("bob"), called_by("ada", "beta")):
            assert await tasks.get("t", other) is None
            assert (await tasks.list(ListTasksRequest(), other)).total_size == 0


async def test_the_oldest_that_have_ended_give_way(tmp_path: Path) -> None:
    ada = called_by("ada")
    gone: list[str] = []
    async with kept(tmp_path, tasks=3) as tasks:
        tasks.forgotten.append(gone.append)
        await tasks.save(made("running", WORKING, age=100), ada)
        for age in (9, 8, 7, 6):
            await tasks.save(made(f"ended-{age}", DONE, age=age), ada)
        await tasks.save(made("of-another", DONE, age=99), called_by("bob"))
        listed = await tasks.list(ListTasksRequest(), ada)
        assert {task.id for task in listed.tasks} == {"running", "ended-7", "ended-6"}
        assert gone == ["ended-9", "ended-8"]
    async with kept(tmp_path) as tasks:
        assert await tasks.get("ended-9", ada) is None
        assert await tasks.get("of-another", called_by("bob")) is not None


async def test_large_tasks_give_way_sooner(tmp_path: Path) -> None:
    ada = called_by("ada")
    async with kept(tmp_path, tasks_size=100_000) as tasks:
        for age in (3, 2, 1):
            task = made(f"ended-{age}", DONE, age=age)
            task.metadata["x"] = "x" * 40_000
            await tasks.save(task, ada)
        listed = await tasks.list(ListTasksRequest(), ada)
        assert [task.id for task in listed.tasks] == ["ended-1", "ended-2"]


async def test_what_ended_too_long_ago_is_let_go_of(tmp_path: Path) -> None:
    ada = called_by("ada")
    async with kept(tmp_path, retention=10) as tasks:
        await tasks.save(made("old", DONE, age=11), ada)
        await tasks.save(made("new", DONE, age=1), ada)
        assert await tasks.get("old", ada) is None
        assert await tasks.get("new", ada) is not None


async def test_a_row_that_cannot_be_read_costs_only_itself(tmp_path: Path) -> None:
    ada = called_by("ada")
    async with kept(tmp_path) as tasks:
        await tasks.save(made("good", DONE), ada)
    async with rows(tmp_path) as store:
        store.put("bad", {"owner": "x", "task": b"\xff\xff"})
        store.put("worse", 7)
    async with kept(tmp_path) as tasks:
        assert await tasks.get("good", ada) is not None
    async with rows(tmp_path) as store:
        assert store.load().keys() == {"good"}


async def test_tasks_and_their_notifications_are_there_after_a_restart(tmp_path: Path) -> None:
    table = 'push = {http = true, private = ["127.0.0.0/8"]}'
    async with receiver() as hook:
        async with agent(table, folder=tmp_path) as site, caller(site) as client:
            task = await sent(client, text(NOWHERE))
            path = f"/a2a/tasks/{task['id']}"
            made = await client.post(f"{path}/pushNotificationConfigs", json={"url": hook.url})
        async with agent(table, folder=tmp_path) as site, caller(site) as client:
            assert (await client.get(path)).json() == task
            listed = (await client.get(f"{path}/pushNotificationConfigs")).json()
            assert listed["configs"] == [made.json()]
