"""`/diagnostics`, status by status."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator

import pytest

from backends.ros2.robot import Robot, RobotNodes, fresh_domain, robot_of
from rcp_kernel.values import Encoding, value_type

pytestmark = pytest.mark.anyio

EVENT = "event/diagnostics"
MOTOR = "sensor/diagnostics/base/motor_left"


@pytest.fixture(scope="module")
def board() -> Iterator[tuple[int, RobotNodes]]:
    domain = fresh_domain()
    robot_nodes = RobotNodes(domain)
    robot_nodes.start()
    yield domain, robot_nodes
    robot_nodes.stop()


@pytest.fixture
async def watched(board: tuple[int, RobotNodes]) -> AsyncIterator[tuple[Robot, RobotNodes]]:
    domain, robot_nodes = board
    if not robot_nodes.runs:
        robot_nodes.start()
    robot_nodes.tell("diagnose", name="/base/motor: left", level=0, message="turns", volts="24.1")
    async with robot_of(domain, expose=["/diagnostics"], diagnostics={"stale": 1.0}) as robot:
        await robot.until(lambda: EVENT in robot.resources)
        await robot.first(MOTOR)
        yield robot, robot_nodes


async def test_a_status_is_a_sensor_with_all_it_says(watched: tuple[Robot, RobotNodes]) -> None:
    robot, _ = watched
    said = await robot.first(MOTOR)
    assert (said.level, said.message, said.hardware_id) == ("ok", "turns", "hw-1")
    assert said.name == "/base/motor: left"
    assert said.values == {"volts": "24.1"}
    assert await robot.read(MOTOR) == said
    stamps = [stamp for name, _, stamp in robot.samples if name == MOTOR]
    assert all(stamps)
    assert value_type(robot.resources[MOTOR].value).check(said)
    assert "sensor/diagnostics" not in robot.resources  # statuses in place of the bare topic


async def test_a_change_of_level_is_an_event_and_more_of_the_same_is_not(
    watched: tuple[Robot, RobotNodes],
) -> None:
    robot, robot_nodes = watched
    assert not robot.of(EVENT)
    robot_nodes.tell("diagnose", name="/base/motor: left", level=2, message="stuck")
    change = await robot.first(EVENT)
    assert (change.path, change.was) == (f"/{MOTOR}", "ok")
    assert (change.now.level, change.now.message) == ("error", "stuck")
    assert value_type(robot.resources[EVENT].value).encode(change, Encoding.JSON)
    heard = len(robot.of(MOTOR))
    await robot.until(lambda: len(robot.of(MOTOR)) > heard + 3)
    assert len(robot.of(EVENT)) == 1


async def test_a_status_that_is_unwell_from_the_first_is_told(
    watched: tuple[Robot, RobotNodes],
) -> None:
    robot, robot_nodes = watched
    robot_nodes.tell("diagnose", name="lidar", level=1, message="dust")
    change = await robot.first(EVENT)
    assert (change.was, change.now.name, change.now.level) == (None, "lidar", "warn")
    await robot.until(lambda: "sensor/diagnostics/lidar" in robot.resources)
    robot_nodes.tell("hush", name="lidar")


async def test_names_that_differ_keep_different_paths(watched: tuple[Robot, RobotNodes]) -> None:
    robot, robot_nodes = watched
    names = ["a b", "a_b", "..", "", "ärger/Öl: 5 %"]
    for name in names:
        robot_nodes.tell("diagnose", name=name, level=0)
    await robot.until(lambda: set(names) <= {v.name for _, v, _ in robot.samples})
    paths = {v.name: n for n, v, _ in robot.samples}
    assert len(set(paths.values())) == len(paths)
    for name in names:
        robot_nodes.tell("hush", name=name)


async def test_a_status_that_is_not_repeated_goes_stale_and_comes_back(
    watched: tuple[Robot, RobotNodes],
) -> None:
    robot, robot_nodes = watched
    robot_nodes.tell("hush", name="/base/motor: left")
    await robot.until(lambda: robot.of(MOTOR)[-1].level == "stale")
    stale = robot.of(MOTOR)[-1]
    assert stale.message == "no update for 1 s; it was ok: turns"
    assert robot.of(EVENT)[-1].now == stale
    robot_nodes.tell("diagnose", name="/base/motor: left", level=0, message="turns")
    await robot.until(lambda: robot.of(MOTOR)[-1].level == "ok")
    assert robot.of(EVENT)[-1].was == "stale"


async def test_a_monitor_that_is_killed_leaves_all_stale_until_it_is_back(
    watched: tuple[Robot, RobotNodes],
) -> None:
    robot, robot_nodes = watched
    robot_nodes.kill()
    await robot.until(lambda: robot.of(MOTOR)[-1].level == "stale")
    robot_nodes.start()
    robot_nodes.tell("diagnose", name="/base/motor: left", level=0, message="turns again")
    await robot.until(lambda: robot.of(MOTOR)[-1].message == "turns again")


async def test_the_event_is_there_before_anybody_publishes() -> None:
    domain = fresh_domain()
    late = RobotNodes(domain)
    async with robot_of(domain, expose=["/diagnostics"], grace=0.1) as robot:
        await robot.until(lambda: EVENT in robot.resources)
        await asyncio.to_thread(late.start)
        try:
            await asyncio.to_thread(late.tell, "diagnose", name="pump", level=2, message="dry")
            change = await robot.first(EVENT)
            assert (change.was, change.now.level, change.now.message) == (None, "error", "dry")
        finally:
            await asyncio.to_thread(late.stop)
