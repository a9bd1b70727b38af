"""The same launch file started twice: two live servers of one action under one full name."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from backends.ros2.robot import BOUND, Peer, Robot, fresh_domain, robot_of
from rcp_kernel.errors import DeviceRejected
from rcp_ros2.servers import ActionServer

pytestmark = pytest.mark.anyio
_MAP = {"/action/fibonacci": {"action": "/fibonacci"}}


class _Twins:
    """Nodes of one name, and their domain: one accepts odd goals only, and late; the other even ones."""

    def __init__(self) -> None:
        self.domain = fresh_domain()
        self.odd, self.even = Peer(self.domain, "twin", "odd"), Peer(self.domain, "twin", "even")

    def each(self, do: Callable[[Peer], None]) -> None:
        with ThreadPoolExecutor() as threads:
            list(threads.map(do, (self.odd, self.even)))


@pytest.fixture(scope="module")
def twins() -> Iterator[_Twins]:
    made = _Twins()
    made.each(Peer.start)
    yield made
    made.each(Peer.stop)


@pytest.fixture(scope="module")
async def module_robot(twins: _Twins) -> AsyncIterator[Robot]:
    async with robot_of(twins.domain, map=_MAP, poll=0.1) as robot:
        await robot.until(lambda: "action/fibonacci" in robot.resources)
        async with asyncio.timeout(BOUND):
            run = _run(robot)
            await run.reach()
            while len(await _ros(robot).call(run.servers)) < 2 or not _servers(robot):  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        yield robot


@pytest.fixture
def robot(module_robot: Robot) -> Robot:
    return module_robot


def _run(robot: Robot) -> Any:
    return robot.backend.catalog.bindings["action/fibonacci"]


def _ros(robot: Robot) -> Any:
    return robot.backend.catalog.shared.ros


def _servers(robot: Robot) -> dict[str, ActionServer]:
    return robot.backend.catalog.shared.keeper.servers


async def _until(holds: Callable[[], Any]) -> None:
    async with asyncio.timeout(BOUND):
        while not holds():  # noqa: ASYNC110 - nothing tells of it
            await asyncio.sleep(0.02)


async def _sent(robot: Robot, order: int) -> bytes:
    """Send a goal past the gateway's commands; return its id."""
    from test_msgs.action import Fibonacci
    from unique_identifier_msgs.msg import UUID

    goal = uuid.uuid4().bytes
    await _ros(robot).call(
        lambda: _run(robot).client.send_goal_async(
            Fibonacci.Goal(order=order), goal_uuid=UUID(uuid=list(goal))
        )
    )
    return goal


async def test_a_goal_that_one_twin_rejects_is_cancelled_at_the_other(
    robot: Robot, twins: _Twins
) -> None:
    steps: list[Any] = []
    goal = robot.input("action/fibonacci", {"order": 2001})
    with pytest.raises(DeviceRejected, match="2 servers of /twin serve it"):
        await robot.backend.execute("action/fibonacci", goal, lambda *_, **__: steps.append(None))
    assert steps  # so that it is `failed`, not `rejected`
    await _until(lambda: twins.odd.truth()["began"] and not twins.odd.truth()["running"])


async def test_a_cancel_after_the_rejection_of_one_twin_is_not_confirmed(
    robot: Robot, twins: _Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes between the rejection and what the gateway makes of it."""
    began = twins.odd.truth()["began"]
    reached = asyncio.Event()
    run = _run(robot)
    servers = run.servers

    def looked() -> frozenset[bytes]:
        robot.call_soon(reached.set)
        return servers()

    calling = asyncio.ensure_future(robot.execute("action/fibonacci", {"order": 2001}))
    while not run._goals:  # noqa: ASYNC110, SLF001 - nothing tells of it, and it ends soon
        await asyncio.sleep(0)
    (goal,) = run._goals  # noqa: SLF001
    await goal._accepted.wait(BOUND)  # noqa: SLF001 - which no reply tells
    monkeypatch.setattr(run, "servers", looked)
    calling.cancel()
    with pytest.raises(DeviceRejected, match="2 servers of /twin serve it"):
        await calling
    assert reached.is_set()
    await _until(lambda: twins.odd.truth()["began"] > began and not twins.odd.truth()["running"])


async def test_one_twin_does_not_end_the_goals_of_the_other(robot: Robot, twins: _Twins) -> None:
    server = _servers(robot)["/fibonacci"]
    goal = await _sent(robot, 2001)
    await _until(lambda: goal in server.goals)
    other = await _sent(robot, 2)
    await _until(lambda: other in server.goals)
    await _until(lambda: other not in server.goals)
    assert goal in server.goals
    await _ros(robot).call(server.cancel, goal)
    await _until(lambda: goal not in server.goals and not twins.odd.truth()["running"])


async def test_what_one_twin_does_not_know_may_run_at_the_other(
    robot: Robot, twins: _Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_ros2.servers._LEASE", 0.0)
    server = _servers(robot)["/fibonacci"]
    goal = await _sent(robot, 2001)
    await _until(lambda: goal in server.goals)
    twins.odd.freeze()
    try:
        before = server.answered_at
        await _ros(robot).call(server.cancel, goal)
        await _until(lambda: server.answered_at > before)
        assert goal in server.goals
    finally:
        twins.odd.thaw()
    await _until(lambda: goal not in server.goals)


async def test_abandoned_goals_are_remembered_although_many_were_rejected(
    robot: Robot, twins: _Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_ros2.servers._GIVEN_UP", 3)
    monkeypatch.setattr("rcp_ros2.servers._REJECTED", 0.3)
    server = _servers(robot)["/fibonacci"]

    def abandon() -> tuple[bytes, list[bytes]]:
        for _ in range(5):
            server.abandon(uuid.uuid4().bytes, rejected=True)
        goal = uuid.uuid4().bytes
        server.abandon(goal)
        for _ in range(5):
            server.abandon(uuid.uuid4().bytes, rejected=True)
        return goal, list(server._abandoned)  # noqa: SLF001 - to wait for its servers takes long

    goal, remembered = await _ros(robot).call(abandon)
    assert goal in remembered
    assert len(remembered) == 3
    await _until(lambda: set(server._abandoned) == {goal})  # noqa: SLF001
    await _ros(robot).call(server._abandoned.clear)  # noqa: SLF001


async def test_the_goals_of_a_twin_that_leaves_are_forgotten(robot: Robot, twins: _Twins) -> None:
    server = _servers(robot)["/fibonacci"]
    goal, kept = await _sent(robot, 2001), await _sent(robot, 2000)
    await _until(lambda: {goal, kept} <= server.goals.keys())
    twins.odd.retire()
    await _until(lambda: goal not in server.goals)
    assert kept in server.goals
    await _ros(robot).call(server.cancel, kept)
    await _until(lambda: not server.goals)
