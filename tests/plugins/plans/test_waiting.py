"""Plans that wait for their turn, and what their check and their steps cost a turn of the loop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Awaitable, Iterator
from contextlib import asynccontextmanager
from itertools import count
from typing import Any

import msgspec
import pytest
from msgspec import Raw

from configuration import key
from kernel.world import Client, World, world_of
from plugins.plans.planned import PEOPLE, begun, code, echo, faults, go, run, send, step
from rcp_kernel.contract.requests import QueuedRequest
from rcp_kernel.model import Resource

pytestmark = pytest.mark.anyio
STOP = {"type": "execute", "path": "/system/estop"}


@asynccontextmanager
async def busy_world(text: str = PEOPLE) -> AsyncGenerator[tuple[World, Client]]:
    """A gateway in whose present turn of the loop there is no time for anything long."""
    async with world_of(text) as world:
        client = world.client()
        world.server.client_api.turns.add(1.0)
        yield world, client


async def test_a_cancel_reaches_a_plan_that_waits_for_its_turn() -> None:
    async with busy_world() as (world, client):
        plan = send(client, go(2.0))
        cancel = client.send(type="cancel", path="/system/plans")
        (command,) = (await client.final(cancel))["body"]["cancelled"]
        reply = await client.final(plan)
        assert (reply["status"], reply["command"]) == ("cancelled", command)
        assert world.robot.started.empty()


async def test_a_cancel_by_somebody_else_reaches_a_plan_that_waits() -> None:
    async with busy_world() as (world, client):
        admin = world.client("admin-admin-admin")
        plan = send(client, go(2.0))
        cancelled = await admin.ask(type="cancel", path="/system/plans")
        assert cancelled["body"] == {"cancelled": []}  # what is in it is not known yet
        assert (await client.final(plan))["status"] == "cancelled"
        assert world.robot.started.empty()


async def test_who_may_start_no_plans_cancels_none_that_waits() -> None:
    async with busy_world() as (world, client):
        plan = send(client, go(2.0))
        guard = world.client("guard-guard-guard")
        refused = guard.send(type="cancel", path="/system/plans")
        assert code(await guard.final(refused)) == "unknown_path"
        assert await begun(world) == 2.0
        world.robot.release.set()
        assert (await client.final(plan))["status"] == "completed"


async def test_few_others_are_remembered_that_cancel_a_plan_while_it_waits() -> None:
    keys = "".join(key(f"also-{n}", f"also-also-also-{n}", role="admin") for n in range(17))
    async with busy_world(PEOPLE + keys) as (world, client):
        plan = send(client, go(2.0))
        others = [world.client(f"also-also-also-{n}") for n in range(17)]
        requests = [other.send(type="cancel", path="/system/plans") for other in others * 2]
        codes = [
            code(await other.final(id_)) for other, id_ in zip(others * 2, requests, strict=True)
        ]
        assert codes == (["completed"] * 16 + ["queue_full"]) * 2
        assert (await client.final(plan))["status"] == "cancelled"


async def test_a_cancel_does_not_reach_a_plan_that_is_sent_after_it() -> None:
    async with busy_world() as (_, client):
        client.send(type="cancel", path="/system/plans")
        assert (await run(client, echo()))["status"] == "completed"


async def test_a_plan_that_waits_while_its_robot_is_stopped_never_starts() -> None:
    async with busy_world() as (world, client):
        admin = world.client("admin-admin-admin")
        plan = send(client, go(2.0))
        stop = admin.send(**STOP)
        reset = admin.send(**STOP, body={"reset": True})
        refused = await client.final(plan)
        assert (code(refused), refused["status"]) == ("estop_active", "rejected")
        for id_ in (stop, reset):
            await admin.final(id_)
        assert world.robot.started.empty()
        world.robot.release.set()
        assert (await run(client, go(2.0)))["status"] == "completed"  # sent after the reset


async def test_a_plan_that_an_adapter_held_back_while_its_robot_was_stopped_never_starts() -> None:
    async with world_of(PEOPLE) as world:
        admin, client_api = world.client("admin-admin-admin"), world.server.client_api
        body = Raw(msgspec.json.encode({"steps": [echo()]}))
        since = time.monotonic()
        await admin.ask(**STOP)
        await admin.ask(**STOP, body={"reset": True})
        session = world.client().connection.session
        for moment, told in ((since, "estop_active"), (time.monotonic(), None)):
            request = QueuedRequest(since=moment, type="execute", path="/system/plans", body=body)
            reply = await client_api.request(session, request)
            assert (reply.error or {}).get("code") == told


# -- what a turn of the loop costs ------------------------------------------------------------------


class Turns:
    """Measures each turn of the loop while entered, in time of the processor."""

    def __init__(self) -> None:
        self.longest = self.total = 0.0
        self._on = True

    def _look(self) -> None:
        moment = time.thread_time()
        took = moment - self._last
        self.longest = max(self.longest, took)
        self.total += took
        self._last = moment
        if self._on:
            asyncio.get_running_loop().call_soon(self._look)

    async def during(self, work: Awaitable[Any]) -> Any:
        """Measure while `work` is done."""
        self._last = time.thread_time()
        asyncio.get_running_loop().call_soon(self._look)
        try:
            return await work
        finally:
            self._on = False


_numbers = count()


def _conditions() -> Iterator[dict[str, Any]]:
    cell = f"[{','.join(['1'] * 50)}]"
    for _ in range(40):  # more than are read of one plan
        text = f"{cell}.all(x, {cell}.all(y, {cell}.all(z, {next(_numbers)} < 0)))"
        yield {"do": "wait", "until": text, "deadline": 2}


def _misspelt() -> Iterator[dict[str, Any]]:
    for number in range(190):
        yield step("read", f"/sensor/of-many/level-numbr-{number:04}")


@pytest.mark.parametrize("made", [_conditions, _misspelt])
async def test_the_check_of_a_plan_takes_many_turns(made: Any) -> None:
    async with world_of() as world:
        names = (f"sensor/of-many/level-number-{number:04}" for number in range(1900))
        world.robot.add(
            *(Resource(name=n, description="One of many.", value=float, live=True) for n in names)
        )
        client, turns = world.client(), Turns()
        reply = await turns.during(run(client, {"do": "parallel", "steps": list(made())}))
        assert reply["status"] == "rejected"
        assert turns.longest < turns.total * 0.6, (turns.longest, turns.total)


@pytest.mark.parametrize("notation", ["lines", "symbolic"])
async def test_of_a_long_plan_no_more_is_read_than_may_be_in_one(notation: str) -> None:
    async with world_of() as world:
        body = {notation: "(a\n" * 20_000}
        reply = await world.client().ask(type="execute", path="/system/plans", body=body)
        assert set(faults(reply).values()) == {"bad_request"}
        assert reply["error"]["details"]["count"] == 201


async def test_misspelt_names_are_looked_for_a_few_times_only() -> None:
    async with world_of() as world:
        steps = [echo({"$result": f"frist-{number}"}) for number in range(20)]
        reply = await run(world.client(), echo(id="first-1"), *steps)
        near = [one["details"] for one in reply["error"]["details"]["faults"] if "details" in one]
        assert near == [{"near": ["first-1"]}] * 5


async def test_results_that_a_value_refers_to_are_bounded_together() -> None:
    async with world_of() as world:
        host = world.robot.host
        host.declare(
            Resource(name="sensor/long", description="Long.", value=list[int], live=True),
            Resource(name="param/any", description="Anything.", value=list[Any]),
        )
        host.publish("sensor/long", [7] * 200_000)
        read = step("read", "/sensor/long", id="long")
        client = world.client()
        reply = await run(client, read, step("write", "/param/any", [{"$result": "long/0"}] * 3))
        assert reply["status"] == "completed"
        (result, *_) = reply["body"]["steps"]
        assert (result.get("result"), result["omitted"]) == (None, 400_001)
        assert world.robot.writes[-1] == ("param/any", [7, 7, 7])
        many = step("write", "/param/any", [{"$result": "long"}] * 3)
        reply = await run(client, read, many)
        assert code(reply) == "precondition_failed"
        assert "more than 1048576 bytes" in reply["message"]


async def test_the_list_of_plans_is_written_in_steps() -> None:
    async with world_of() as world:
        client = world.client()
        await run(client, echo())
        session = client.connection.session
        view = world.server.gateway.system.views["/system/plans"](session)
        assert isinstance(view, Iterator)
