"""Simulated time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import suppress

import pytest

from backends.ros2.robot import BOUND, Robot, RobotNodes, fresh_domain, robot_of
from rcp_kernel.errors import InvalidValue

pytestmark = pytest.mark.anyio

S = 1_000_000_000
CLOCK, JUMP, NOTE = "sensor/clock", "event/clock_jump", "sensor/note"


@pytest.fixture(scope="module")
def simulator() -> Iterator[tuple[int, RobotNodes]]:
    domain = fresh_domain()
    robot_nodes = RobotNodes(domain)
    robot_nodes.start()
    yield domain, robot_nodes
    robot_nodes.stop()


@pytest.fixture
async def simulated(simulator: tuple[int, RobotNodes]) -> AsyncIterator[tuple[Robot, RobotNodes]]:
    domain, robot_nodes = simulator
    expose = ["/note", "/tf", "/tf_static"]
    async with robot_of(domain, expose=expose, use_sim_time=True) as robot:
        await robot.until(lambda: {CLOCK, JUMP, NOTE} <= robot.resources.keys())
        yield robot, robot_nodes


async def repeated(robot: Robot, once: Callable[[], object], holds: Callable[[], bool]) -> None:
    """Do something until it is heard: nothing tells a publisher whom it has found."""
    async with asyncio.timeout(BOUND):
        while not holds():
            once()
            with suppress(TimeoutError):
                await robot.until(holds, 0.1)


async def test_what_carries_no_time_has_the_robots(simulated: tuple[Robot, RobotNodes]) -> None:
    robot, robot_nodes = simulated

    def stamps() -> list[int | None]:
        return [stamp for name, _, stamp in robot.samples if name == NOTE]

    async with robot.backend.watch(NOTE, None), robot.backend.watch(CLOCK, None):
        await repeated(
            robot, lambda: robot_nodes.tell("tick", time=40 * S), lambda: 40 * S in stamps()
        )
        assert robot.of(CLOCK)[-1].sec == 40
    assert not robot.of(JUMP)


async def test_a_jump_back_is_told_and_what_moved_is_forgotten(
    simulated: tuple[Robot, RobotNodes],
) -> None:
    robot, robot_nodes = simulated
    here = [1.0, 0, 0, 0, 0, 0, 1]
    pair = "sensor/tf/odom/base_link"

    def drive() -> None:
        robot_nodes.tell("tick", time=50 * S)
        robot_nodes.tell("move", parent="odom", child="base_link", time=50 * S, place=here)

    robot_nodes.tell("fix", by="arm", parent="base_link", child="camera", place=here)
    await repeated(robot, drive, lambda: pair in robot.resources)

    async def is_fixed() -> bool:
        with suppress(InvalidValue):
            await robot.execute("service/lookup_transform", fix)
            return True
        return False

    fix = {"target": "base_link", "source": "camera"}
    await robot.until_async(is_fixed, bool)  # a transform of its own topic, in its own time
    robot_nodes.tell("tick", time=2 * S)
    jump = await robot.first(JUMP)
    assert (jump.before, jump.after) == (50.0, 2.0)
    lookup = {"target": "odom", "source": "base_link"}
    with pytest.raises(InvalidValue):
        await robot.execute("service/lookup_transform", lookup | {"time": 50.0})
    fixed = await robot.execute("service/lookup_transform", fix)
    assert fixed.transform.translation.x == 1.0


async def test_a_clock_that_nobody_runs_is_told() -> None:
    async with robot_of(fresh_domain(), use_sim_time=True, grace=0.5) as robot:
        await robot.until(lambda: any("/clock" in (text or "") for text in robot.reports))
