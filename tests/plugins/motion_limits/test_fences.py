"""Robots stay where their drivers may have them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from kernel.fenced import (
    AGENT,
    BLIND,
    EDGE,
    GOALS,
    OPERATOR,
    code,
    drive,
    fenced,
    goal,
    reached,
    reconfigured,
    twist,
)
from kernel.world import BOUND
from plugins.audit.test_audit import records
from rcp_gateway.testing import SteppedClock
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.types import Twist
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Request
from work import lines_run

pytestmark = pytest.mark.anyio


async def test_a_goal_outside_the_fence_or_in_a_forbidden_area_is_refused() -> None:
    async with fenced(GOALS) as world:
        client = world.client()
        for x, y, wanted in [
            (1, 1, None),
            (9, 9, None),
            (4.5, 4.6, None),
            (9.1, 1, "field"),
            (4.7, 4.3, "pit"),
            (4, 4, "pit"),
        ]:
            envelope = {
                "type": "execute",
                "path": "/action/move",
                "body": goal(x, y),
                "dry_run": True,
            }
            reply = await client.ask(**envelope)
            assert code(reply) == ("completed" if wanted is None else "out_of_range"), (x, y)
        refusal = await client.ask(type="execute", path="/action/move", body=goal(10, 1))
        assert (
            refusal["error"]["message"] == "the position (10, 1) of action 'move' is outside "
            "of hall"
        )
        assert refusal["error"]["details"]["fence"] == ["hall"]
        assert world.robot.writes == []


async def test_a_robot_outside_its_fence_takes_no_command_of_a_fenced_role() -> None:
    async with fenced(EDGE) as world:
        agent = world.client(AGENT)
        assert code(await drive(agent, 0.1)) == "precondition_failed"
        world.robot.at(1)
        assert code(await drive(agent, 0.1)) == "completed"
        world.robot.at(11)
        refusal = await drive(agent, 0.1)
        assert refusal["error"]["message"] == "the robot at (11, 0) is outside of hall"
        assert refusal["error"]["details"]["place"] == [11.0, 0.0]
        assert code(await drive(world.client(OPERATOR), -0.1)) == "completed"
        world.robot.at(9)
        assert code(await drive(agent, 0.1)) == "completed"


async def test_where_the_robot_is_is_told_to_those_who_may_read_it() -> None:
    async with fenced(EDGE.replace('"agent"', '"blind"')) as world:
        world.robot.at(11.25)
        refusal = await drive(world.client(BLIND), 0.1)
        assert refusal["error"]["code"] == "out_of_range"
        assert "11.25" not in str(refusal)


async def test_a_place_that_is_too_old_is_not_known(stepped: SteppedClock) -> None:
    edge = EDGE.replace('"sensor/pose",', '"sensor/pose", max_age = 60,')
    async with fenced(edge, stepped.clock) as world:
        world.robot.at(1)
        assert code(await drive(world.client(AGENT), 0.1)) == "completed"
        stepped.advance(61)
        assert code(await drive(world.client(AGENT), 0.1)) == "precondition_failed"


async def test_a_robot_that_leaves_its_fence_is_stopped_at_once() -> None:
    async with fenced(EDGE) as world:
        agent, robot = world.client(AGENT), world.robot
        robot.at(9)
        assert code(await drive(agent, 0.5)) == "completed"
        robot.at(9.9)
        assert len(reached(world)) == 1
        robot.at(10.1)
        notice = await agent.notice("fence_left")
        assert notice["envelope"] == "hall"
        assert "is outside of hall" in notice["message"]
        watcher = world.client(OPERATOR)
        id_ = watcher.send(type="subscribe", path="/actuator/drive")
        await watcher.until(
            lambda m: m.get("id") == id_ and m["type"] == "update" and m["body"]["linear"]["x"] == 0
        )
        assert reached(world)[-1] == Twist()
        count = len(reached(world))
        robot.at(10.2)
        assert len(reached(world)) == count
        assert code(await drive(agent, -0.5)) == "out_of_range"


async def test_a_stop_at_the_fence_is_on_record_with_whose_drive_it_ended() -> None:
    async with fenced(EDGE) as world:
        watcher = world.client(OPERATOR)
        id_ = watcher.send(type="subscribe", path="/actuator/drive")
        await watcher.final(id_)
        world.robot.at(9)
        assert code(await drive(world.client(AGENT), 0.5)) == "completed"
        world.robot.at(10.1)
        await watcher.until(
            lambda m: m.get("id") == id_ and m["type"] == "update" and m["body"]["linear"]["x"] == 0
        )
        [left] = await records(world, what="fence")
        assert (left["principal"], left["envelope"], left["outcome"]) == (
            "agent",
            "hall",
            "stopped",
        )
        assert (left["path"], left["tenant"]) == ("/tenant/alpha/actuator/drive", "alpha")
        assert "is outside of hall" in left["reason"]
        [stop] = await records(world, what="deadman")
        assert (stop["outcome"], stop["value"]["linear"]["x"]) == ("ok", 0)
        assert stop["seq"] > left["seq"]


async def test_who_drives_by_single_requests_hears_of_the_fence_where_it_listens() -> None:
    async with fenced(EDGE) as world:
        client_api, listener = world.server.client_api, world.client(AGENT)
        world.robot.at(9)
        write = Request(type="write", path="/actuator/drive", encoding=Encoding.JSON)
        write.body = type(write.body)(b'{"linear":{"x":0.5}}')
        session = client_api.session(client_api.authenticate(AGENT))
        assert (await client_api.request(session, write)).status == "completed"
        world.robot.at(10.1)
        assert (await listener.notice("fence_left"))["envelope"] == "hall"


async def test_who_is_not_fenced_drives_on_outside() -> None:
    async with fenced(EDGE) as world:
        robot = world.robot
        robot.at(9)
        assert code(await drive(world.client(AGENT), 0.5)) == "completed"
        assert code(await drive(world.client(OPERATOR), 0.5)) == "completed"
        robot.at(11)
        assert code(await drive(world.client(OPERATOR), 0.4)) == "completed"
        assert [value.linear.x for value in reached(world)] == [0.5, 0.5, 0.4]  # nor stopped it


async def test_an_action_that_leaves_the_fence_is_cancelled() -> None:
    async with fenced(EDGE) as world:
        agent, robot = world.client(AGENT), world.robot
        robot.at(9)
        id_ = agent.send(type="execute", path="/action/move", body=goal(20))
        await robot.started.get()
        robot.at(11)
        reply = await agent.final(id_)
        assert code(reply) == "cancelled"
        assert "is outside of hall" in reply["error"]["message"]


async def test_a_write_under_way_is_cut_short_when_the_robot_leaves_its_fence() -> None:
    async with fenced(EDGE) as world:
        agent, robot = world.client(AGENT), world.robot
        seen: asyncio.Queue[Any] = asyncio.Queue()

        async def write(_name: str, value: Any) -> None:
            seen.put_nowait(value)
            if value != Twist():
                await asyncio.Event().wait()

        robot.write = write
        robot.at(9)
        id_ = agent.send(type="write", path="/actuator/drive", body=twist(0.5))
        async with asyncio.timeout(BOUND):
            assert await seen.get() != Twist()
            robot.at(11)
            assert await seen.get() == Twist()
        assert code(await agent.final(id_)) in ("cancelled", "out_of_range")


LASTING = EDGE.replace('"sensor/pose",', '"sensor/pose", max_age = 60,')


async def test_an_action_ends_when_the_position_becomes_unknown(stepped: SteppedClock) -> None:
    async with fenced(LASTING, stepped.clock) as world:  # the sensor's own deadline is 10 s
        agent, robot = world.client(AGENT), world.robot
        robot.at(9)
        id_ = agent.send(type="execute", path="/action/move", body=goal(5))
        await robot.started.get()
        for x in (8, 7):
            stepped.advance(6)
            robot.at(x)
            assert code(await drive(agent, 0.0)) == "completed"
        stepped.advance(11)
        reply = await agent.final(id_)
        assert code(reply) == "cancelled"
        assert "position is unknown" in reply["error"]["message"]
        assert (await agent.notice("fence_left"))["envelope"] == "hall"


async def test_a_value_in_force_ends_when_the_position_becomes_unknown(
    stepped: SteppedClock,
) -> None:
    edge = EDGE.replace('"sensor/pose",', '"sensor/pose", max_age = 2,')
    async with fenced(edge, stepped.clock) as world:
        agent, robot = world.client(AGENT), world.robot
        robot.at(9)
        assert code(await drive(agent, 0.5)) == "completed"
        stepped.advance(2.5)  # the value would be valid for 5 s
        notice = await agent.notice("fence_left")
        assert "position is unknown" in notice["message"]
        [record] = await records(world, what="fence")
        assert "position is unknown" in record["reason"]
        watcher = world.client(OPERATOR)
        id_ = watcher.send(type="subscribe", path="/actuator/drive")
        await watcher.until(
            lambda m: m.get("id") == id_ and m["type"] == "update" and m["body"]["linear"]["x"] == 0
        )


async def test_a_position_without_numbers_ends_what_moves() -> None:
    async with fenced(EDGE) as world:
        agent, robot = world.client(AGENT), world.robot
        robot.at(9)
        id_ = agent.send(type="execute", path="/action/move", body=goal(5))
        await robot.started.get()
        robot.at(float("nan"))
        assert code(await agent.final(id_)) == "cancelled"


async def test_a_robot_that_moves_ends_when_a_fence_is_added_without_a_position(
    stepped: SteppedClock,
) -> None:
    async with fenced("", stepped.clock) as world:
        agent, robot = world.client(AGENT), world.robot
        id_ = agent.send(type="execute", path="/action/move", body=goal(5))
        await robot.started.get()
        await reconfigured(world, EDGE)
        assert code(await agent.final(id_)) == "cancelled"


async def test_a_position_costs_the_same_however_many_commands_run_elsewhere() -> None:
    async with fenced(EDGE) as world:
        agent, robot = world.client(AGENT), world.robot
        journal = world.server.gateway.journal
        work: list[int] = []
        for count in (10, 2000):
            for number in range(count):
                path = f"/tenant/alpha/action/elsewhere/{number % 3}"
                command = Command(f"{count}-{number}", path, "agent", "alpha")
                journal.write(command, Record("accepted", 1))
            robot.at(9)
            id_ = agent.send(type="execute", path="/action/move", body=goal(5))
            await robot.started.get()
            robot.at(8)
            work.append(lines_run(lambda: robot.at(7)))
            robot.at(11)
            assert code(await agent.final(id_)) == "cancelled"
        assert work[0] == work[1] > 0


async def test_commands_within_the_fence_are_not_looked_at_one_by_one() -> None:
    edge = EDGE.replace('"/action/move"]', '"/action/**"]')
    async with fenced(edge) as world:
        agent, robot = world.client(AGENT), world.robot
        robot.at(9)
        sent = [agent.send(type="execute", path="/action/many", body=goal(5))]
        await robot.started.get()
        robot.at(8)
        few = lines_run(lambda: robot.at(7))
        for _ in range(20):
            sent.append(agent.send(type="execute", path="/action/many", body=goal(5)))
            await robot.started.get()
        assert lines_run(lambda: robot.at(6)) == few > 0
        robot.at(11)
        assert {code(await agent.final(id_)) for id_ in sent} == {"cancelled"}
