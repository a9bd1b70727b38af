"""Lifecycle nodes: state and transitions."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator

import pytest

from backends.ros2.robot import BOUND, Robot, RobotNodes, fresh_domain, robot_of
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    DeviceTimeout,
    EstopActive,
    RcpError,
)

pytestmark = pytest.mark.anyio

SENSOR = "sensor/lifecycle/camera/driver"
SERVICE = "service/lifecycle/camera/driver"


@pytest.fixture(scope="module")
async def managed(nodes_domain: int, robot_nodes: RobotNodes) -> AsyncIterator[Robot]:
    async with robot_of(nodes_domain, expose=["/camera/**"]) as robot:
        await robot.until(lambda: {SENSOR, SERVICE} <= robot.resources.keys())
        yield robot


@pytest.fixture
async def unconfigured(managed: Robot, robot_nodes: RobotNodes) -> Robot:
    """The backend, with a driver that has just begun."""
    robot_nodes.tell("break_", broken=False)
    for transition in ("deactivate", "cleanup"):
        state = await managed.read(SENSOR)
        if transition in state.transitions:
            robot_nodes.tell("lead", transition=transition)
    assert (await managed.read(SENSOR)).state == "unconfigured"
    managed.samples.clear()
    return managed


async def lead(robot: Robot, transition: str) -> str:
    return (await robot.execute(SERVICE, {"transition": transition})).state


async def test_a_lifecycle_node_is_found_by_its_pattern_and_its_plumbing_is_not(
    managed: Robot,
) -> None:
    names = {n for n in managed.resources if not n.startswith("param/")}
    assert names == {SENSOR, SERVICE}


async def test_a_node_is_led_through_its_whole_life(unconfigured: Robot) -> None:
    assert await lead(unconfigured, "configure") == "inactive"
    assert await lead(unconfigured, "activate") == "active"
    state = await unconfigured.read(SENSOR)
    assert (state.state, state.transitions) == ("active", ["deactivate", "shutdown"])
    assert await lead(unconfigured, "deactivate") == "inactive"
    assert await lead(unconfigured, "cleanup") == "unconfigured"


async def test_a_transition_that_is_not_possible_is_refused_with_those_that_are(
    unconfigured: Robot,
) -> None:
    with pytest.raises(DeviceRejected, match="is unconfigured and cannot activate") as caught:
        await lead(unconfigured, "activate")
    assert caught.value.remedy == "From unconfigured it can configure or shutdown."
    assert caught.value.details == {
        "state": "unconfigured",
        "transitions": ["configure", "shutdown"],
    }


async def test_a_transition_the_node_fails_at_is_refused_with_the_state_it_is_in(
    unconfigured: Robot, robot_nodes: RobotNodes
) -> None:
    await lead(unconfigured, "configure")
    robot_nodes.tell("break_", broken=True)
    with pytest.raises(DeviceRejected, match="it was inactive and is now inactive"):
        await lead(unconfigured, "activate")


async def test_a_change_by_somebody_else_is_told_at_once(
    unconfigured: Robot, robot_nodes: RobotNodes
) -> None:
    shared = unconfigured.backend.catalog.shared
    ros = shared.ros
    async with unconfigured.backend.watch(SENSOR, None):
        assert (await unconfigured.first(SENSOR)).state == "unconfigured"
        robot_nodes.tell("lead", transition="configure")
        await unconfigured.until(lambda: unconfigured.of(SENSOR)[-1].state == "inactive")
    left = await ros.call(lambda: [s.topic_name for s in ros.node.subscriptions])
    assert left == ["/parameter_events"]


async def test_under_an_estop_a_node_is_led_down_and_not_up(unconfigured: Robot) -> None:
    await lead(unconfigured, "configure")
    await lead(unconfigured, "activate")
    unconfigured.latched.add(None)
    try:
        assert await lead(unconfigured, "deactivate") == "inactive"
        with pytest.raises(EstopActive, match="is not allowed to activate"):
            await lead(unconfigured, "activate")
        assert await lead(unconfigured, "cleanup") == "unconfigured"
        with pytest.raises(EstopActive, match="is not allowed to configure"):
            await lead(unconfigured, "configure")
    finally:
        unconfigured.latched.clear()


@pytest.fixture
def mortal() -> Iterator[tuple[int, RobotNodes]]:
    domain = fresh_domain()
    robot_nodes = RobotNodes(domain)
    robot_nodes.start()
    yield domain, robot_nodes
    robot_nodes.stop()


async def test_a_node_that_is_killed_and_comes_back_is_at_its_beginning_again(
    mortal: tuple[int, RobotNodes],
) -> None:
    domain, robot_nodes = mortal
    async with robot_of(domain, expose=["/camera/driver"], timeout=3.0) as robot:
        await robot.until(lambda: {SENSOR, SERVICE} <= robot.resources.keys())
        async with robot.backend.watch(SENSOR, None):
            assert await lead(robot, "configure") == "inactive"
            await robot.until(lambda: any(s.state == "inactive" for s in robot.of(SENSOR)))
            robot_nodes.kill()
            with pytest.raises(RcpError):
                await robot.read(SENSOR)
            robot_nodes.start()
            await robot.until(lambda: robot.of(SENSOR)[-1].state == "unconfigured")
        async with asyncio.timeout(BOUND):
            while True:
                try:
                    assert await lead(robot, "configure") == "inactive"
                    break
                except DeviceTimeout:  # the dead one is still listed, and may be asked first
                    continue


async def test_a_node_that_leaves_says_so(mortal: tuple[int, RobotNodes]) -> None:
    domain, robot_nodes = mortal
    async with robot_of(domain, expose=["/camera/driver"]) as robot:
        await robot.until(lambda: {SENSOR, SERVICE} <= robot.resources.keys())
        shared = robot.backend.catalog.shared
        robot_nodes.stop()
        assert await shared.until(lambda: not shared.graph.lifecycle, BOUND)
        with pytest.raises(
            AdapterUnavailable, match="lifecycle node /camera/driver is not running"
        ):
            async with asyncio.timeout(BOUND):
                await robot.read(SENSOR)
