"""What others do on the robot: goals they send, services they call, parameters they change."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

import rcp_ros2
from backends.ros2.robot import BOUND, Fleet, Robot, robot_of
from configuration import backend, key
from rcp_gateway.testing import eventually, serve
from rcp_kernel.errors import AdapterUnavailable, Cancelled, DeviceRejected, InvalidValue
from rcp_kernel.values import Encoding, value_type

pytestmark = pytest.mark.anyio

SPACE = "/fleet/r1"
ACTION = "action/fleet/r1/navigate"
GOALS = "sensor/goals/fleet/r1/navigate"
CANCEL = "service/cancel/fleet/r1/navigate"
CALLS = "event/calls/fleet/r1/dock"


@pytest.fixture(scope="module")
async def module_seen(fleet_domain: int, fleet: Fleet) -> AsyncIterator[Robot]:
    both = {"node": f"{SPACE}/rover", "parameters": ["low", "high"]}
    config: dict[str, Any] = {"expose": [f"{SPACE}/*"], "map": {"/service/limits": both}}
    async with robot_of(fleet_domain, **config) as robot:
        await robot.until(lambda: {GOALS, ACTION, "service/limits"} <= robot.resources.keys())
        await robot.until(lambda: robot.resources["service/limits"].input is not Any)
        await robot.until(lambda: "param/fleet/r1/rover/low" in robot.resources)
        yield robot


@pytest.fixture
def seen(module_seen: Robot) -> Robot:
    module_seen.samples.clear()
    return module_seen


def steps(robot: Robot, count: int, *, firm: bool = False) -> Any:
    return robot.input(ACTION, {"nested_field": {"int32_value": count, "bool_value": firm}})


async def moving(robot: Robot, goal: Any) -> asyncio.Future[Any]:
    """Start a goal and return when it gives feedback."""
    moves = asyncio.Event()
    command = asyncio.ensure_future(
        robot.backend.execute(ACTION, goal, lambda *_, **__: moves.set())
    )
    await asyncio.wait_for(moves.wait(), BOUND)
    return command


async def test_goals_tell_how_they_stand_and_who_sent_them(seen: Robot, fleet: Fleet) -> None:
    async with seen.backend.watch(GOALS, None):
        fleet.tell("go", space=SPACE, steps=2)
        done = await seen.until(lambda: [g for g in seen.of(GOALS)[-1:] if _ended(g)])
        assert [(g.sender, g.status) for g in done[0][:1]] == [("other", "succeeded")]
        await seen.backend.execute(ACTION, steps(seen, 1), lambda *_, **__: None)
        await seen.until(lambda: seen.of(GOALS)[-1][0].sender == "gateway")
        await seen.until(lambda: seen.of(GOALS)[-1][0].status == "succeeded")
    declared = value_type(seen.resources[GOALS].value)
    assert declared.encode(seen.of(GOALS)[-1], Encoding.JSON)


def _ended(goals: list[Any]) -> bool:
    return bool(goals) and goals[0].status == "succeeded"


async def test_the_goals_that_were_are_known_to_one_that_comes_late(
    seen: Robot, fleet: Fleet
) -> None:
    fleet.tell("go", space=SPACE, steps=1)
    await seen.until_async(lambda: seen.read(GOALS), _ended)


async def test_a_goal_of_another_client_is_cancelled(seen: Robot, fleet: Fleet) -> None:
    before = {goal.id for goal in await seen.read(GOALS)}  # what was told last may be of these
    async with seen.backend.watch(GOALS, None):
        fleet.tell("go", space=SPACE, steps=400)
        [running] = await seen.until(
            lambda: [goal for goal in _in(seen, "executing") if goal.id not in before]
        )
        assert running.sender == "other"
        done = await seen.execute(CANCEL, {"id": running.id})
        assert done.ids == [running.id]
        await seen.until(lambda: _in(seen, "canceled"))
        with pytest.raises(DeviceRejected, match="already ended"):
            await seen.execute(CANCEL, {"id": running.id})
        with pytest.raises(InvalidValue, match="has no goal"):
            await seen.execute(CANCEL, {"id": "f" * 32})
        assert (await seen.execute(CANCEL)).ids == []


async def test_a_server_that_refuses_to_cancel_is_told(seen: Robot, fleet: Fleet) -> None:
    command = await moving(seen, steps(seen, 100, firm=True))
    try:
        with pytest.raises(DeviceRejected, match="refuses to cancel"):
            await seen.execute(CANCEL, {})
    finally:
        fleet.tell("go", space=SPACE, steps=1)  # displaces it
        with pytest.raises(DeviceRejected, match="aborted the goal"):
            await asyncio.wait_for(command, BOUND)


def _in(robot: Robot, status: str) -> list[Any]:
    return [goal for goal in [*robot.of(GOALS)[-1:], []][0] if goal.status == status][:1]


async def test_a_goal_that_another_one_displaces_is_aborted_with_its_result(
    seen: Robot, fleet: Fleet
) -> None:
    command = await moving(seen, steps(seen, 200))
    fleet.tell("go", space=SPACE, steps=1)
    with pytest.raises(DeviceRejected, match="aborted the goal"):
        await asyncio.wait_for(command, BOUND)


async def test_a_preempting_command_cancels_the_running_one_at_the_robot(
    fleet_domain: int, fleet: Fleet
) -> None:
    mapped = {
        "/action/go": {"action": "navigate", "policy": "preempt"},
        "/action/wait": {"action": "navigate"},
    }
    ros = backend(use="ros2", domain_id=fleet_domain, namespace="/fleet/r2", map=mapped)
    text = ros + key("operator", "operator-operator")
    async with serve(text, *rcp_ros2.rcp_backends()) as served:
        client = served.client("operator-operator")
        await eventually(lambda: _opened(served), "the backend is open", BOUND)
        opened: Any = served.life.backend
        shared = opened.catalog.shared
        assert await shared.until(lambda: "/fleet/r2/navigate" in shared.graph.actions, BOUND)
        await eventually(lambda: _known(served, "/tenant/alpha/action/go"), "it is told", BOUND)

        def go(steps: int) -> dict[str, Any]:
            return {"nested_field": {"int32_value": steps}}

        first = await client.send(type="execute", path="/action/go", body=go(400))
        running = await client.until(
            lambda m: m.get("id") == first and "body" in m and m.get("status") == "in_progress",
            BOUND,
        )
        assert running["body"]["nested_field"]["int32_value"] > 300
        second = await client.request("execute", "/action/go", body=go(2), within=BOUND)
        assert second["status"] == "completed"
        assert (await client.final(first, BOUND))["status"] == "cancelled"

        third = await client.send(type="execute", path="/action/wait", body=go(100))
        waiting = await client.until(lambda m: m.get("id") == third and "body" in m, BOUND)
        fourth = await client.request("execute", "/action/wait", body=go(1), within=BOUND)
        assert fourth["error"]["code"] == "already_running"
        await client.request("cancel", command=waiting["command"])
        assert (await client.final(third, BOUND))["status"] == "cancelled"
        await client.close()


async def _known(served: Any, path: str) -> bool:
    return path in served.server.gateway.registry.entries


async def _opened(served: Any) -> bool:
    return bool(served.lives)


async def test_a_goal_out_of_reach_is_rejected(seen: Robot) -> None:
    with pytest.raises(DeviceRejected, match="rejected the goal"):
        await seen.backend.execute(ACTION, steps(seen, 2000), lambda *_, **__: None)


async def test_a_cancel_that_the_server_refuses_is_told_and_the_goal_goes_on(seen: Robot) -> None:
    command = await moving(seen, steps(seen, 30, firm=True))
    with pytest.raises(DeviceRejected, match="refuses to cancel; the goal continues"):
        await asyncio.wait_for(seen.backend.halt(), BOUND)
    await asyncio.wait_for(command, BOUND)


async def test_a_cancel_in_the_middle_ends_the_goal(seen: Robot) -> None:
    command = await moving(seen, steps(seen, 500))
    await asyncio.wait_for(seen.backend.halt(), BOUND)
    with pytest.raises(Cancelled):
        await asyncio.wait_for(command, BOUND)


async def test_calls_of_a_service_are_told_once_its_introspection_is_on(
    seen: Robot, fleet: Fleet
) -> None:
    assert CALLS not in seen.resources
    fleet.tell("introspect", space=SPACE)
    await seen.until(lambda: CALLS in seen.resources)
    await seen.until_async(lambda: _call(seen), lambda told: len(told) >= 2)
    asked, answered = seen.of(CALLS)[:2]
    assert (asked.step, asked.request.data, asked.response) == ("request_received", True, None)
    assert (answered.step, answered.response.message) == ("response_sent", "docked: True")
    assert asked.number == answered.number
    assert asked.client == answered.client
    declared = value_type(seen.resources[CALLS].value)
    assert declared.encode(answered, Encoding.JSON)


async def _call(robot: Robot) -> list[Any]:
    """Call the service; its first calls may come before the subscription is matched."""
    await robot.execute("service/fleet/r1/dock", {"data": True})
    await asyncio.sleep(0.05)
    return robot.of(CALLS)


async def test_parameters_are_set_together_or_not_at_all(seen: Robot, fleet: Fleet) -> None:
    await seen.execute("service/limits", {"low": 5.0, "high": 6.0})
    assert fleet.tell("parameter", space=SPACE, name="low") == 5.0
    with pytest.raises(DeviceRejected, match="low is above high"):
        await seen.execute("service/limits", {"low": 9.0, "high": 1.0})
    assert fleet.tell("parameter", space=SPACE, name="high") == 6.0
    await seen.execute("service/limits", {"low": 1.0})
    with pytest.raises(InvalidValue, match="no parameter given"):
        await seen.execute("service/limits", {})


async def test_a_parameter_that_somebody_else_changes_is_told(seen: Robot, fleet: Fleet) -> None:
    path = "param/fleet/r1/rover/low"
    async with seen.backend.watch(path, None):
        await seen.first(path)
        fleet.tell("put", space=SPACE, name="low", value=0.25)
        await seen.until(lambda: seen.of(path)[-1] == 0.25)


async def test_parameters_come_and_go_while_the_node_runs(seen: Robot, fleet: Fleet) -> None:
    path = "param/fleet/r1/rover/late"
    fleet.tell("declare", space=SPACE, name="late", value=3)
    await seen.until(lambda: path in seen.resources)
    assert await seen.read(path) == 3
    fleet.tell("undeclare", space=SPACE, name="late")  # which rclpy tells nobody of
    with pytest.raises(AdapterUnavailable, match="no longer has a parameter 'late'"):
        await seen.read(path)
    await seen.until(lambda: path not in seen.resources)
    fleet.tell("declare", space=SPACE, name="late", value="now a text")
    await seen.until(lambda: path in seen.resources)
    assert await seen.read(path) == "now a text"
    fleet.tell("undeclare", space=SPACE, name="late")
