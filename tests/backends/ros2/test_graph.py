"""The graph as a sensor, what does not fit in it, and the robot's description."""

from __future__ import annotations

from collections.abc import AsyncIterator
from itertools import pairwise
from typing import Any

import pytest

from backends.ros2.robot import Robot, RobotNodes, fresh_domain, robot_of
from rcp_kernel.values import Encoding, value_type
from rcp_ros2.qos import Terms, mismatches

pytestmark = pytest.mark.anyio

GRAPH = "sensor/ros/graph"
S = 1_000_000_000


@pytest.fixture(scope="module")
async def seen(domain: int, peer: object) -> AsyncIterator[Robot]:
    async with robot_of(domain, graph=True, expose=["/robot_description"]) as robot:
        await robot.until(lambda: {GRAPH, "sensor/robot_description"} <= robot.resources.keys())
        yield robot


def topic(graph: Any, name: str) -> Any:
    return next(t for t in graph.topics if t.name == name)


async def known(robot: Robot) -> Any:
    """Return the graph once all of the peer has been discovered: that comes in pieces."""
    async with robot.backend.watch(GRAPH, None):
        return await robot.until(
            lambda: next(
                (
                    g
                    for g in robot.of(GRAPH)
                    if "/peer" in g.nodes
                    and g.actions
                    and any(s.name == "/reset" for s in g.services)
                    and any(
                        e.node == "/peer"
                        for t in g.topics
                        if t.name == "/imu"
                        for e in t.publishers
                    )
                ),
                None,
            )
        )


async def test_the_graph_tells_nodes_topics_services_and_actions(seen: Robot) -> None:
    graph = await known(seen)
    assert {"/peer", "/rcp_gateway"} <= set(graph.nodes)
    imu = topic(graph, "/imu")
    assert imu.types == ["sensor_msgs/msg/Imu"]
    assert [(e.node, e.reliability, e.durability) for e in imu.publishers] == [
        ("/peer", "best_effort", "volatile")
    ]
    assert ("/reset", ["std_srvs/srv/Trigger"]) in [(s.name, s.types) for s in graph.services]
    assert [(a.name, a.types) for a in graph.actions] == [
        ("/fibonacci", ["test_msgs/action/Fibonacci"])
    ]
    declared = value_type(seen.resources[GRAPH].value)
    assert declared.encode(graph, Encoding.JSON)


async def test_a_change_of_the_graph_is_told_and_no_change_is_not() -> None:
    domain = fresh_domain()
    robot_nodes = RobotNodes(domain)
    async with robot_of(domain, graph=True, poll=0.2, grace=0.5) as robot:
        await robot.until(lambda: GRAPH in robot.resources)
        async with robot.backend.watch(GRAPH, None):
            await robot.first(GRAPH)
            robot_nodes.start()
            try:
                await robot.until(lambda: "/monitor" in robot.of(GRAPH)[-1].nodes)
                robot_nodes.stop()
                await robot.until(lambda: "/monitor" not in robot.of(GRAPH)[-1].nodes)
            finally:
                robot_nodes.stop()
            values = robot.of(GRAPH)
            assert all(a != b for a, b in pairwise(values))


async def test_what_does_not_fit_is_in_the_graph_in_words(
    domain: int, peer: object, seen: Robot
) -> None:
    wrong = {"topic": "/imu", "qos": {"reliability": "reliable"}}
    async with (
        robot_of(domain, map={"/sensor/imu": wrong}, node="demanding") as demanding,
        demanding.backend.watch("sensor/imu", None),
        seen.backend.watch(GRAPH, None),
    ):
        message = "/peer publishes best effort and /demanding requests reliable"
        await seen.until(
            lambda: any(message in " ".join(topic(g, "/imu").mismatches) for g in seen.of(GRAPH))
        )


async def test_an_actuator_that_does_not_reach_its_listeners_says_so(
    domain: int, peer: object
) -> None:
    weak = {"topic": "/cmd_vel", "qos": {"reliability": "best_effort"}}
    async with robot_of(domain, map={"/actuator/cmd_vel": weak}, grace=1.0) as robot:
        message = "/cmd_vel does not reach every subscriber"
        await robot.until(lambda: robot.reports and message in (robot.reports[-1] or ""))


async def test_the_robots_description_is_its_text(seen: Robot) -> None:
    assert "peer_description" in await seen.read("sensor/robot_description")


def test_every_policy_that_does_not_fit_is_told_with_what_mends_it() -> None:
    offer = Terms("/a", reliable=False, latched=False, deadline=2 * S, lease=3 * S)
    ask = Terms("/b", reliable=True, latched=True, deadline=S, manual=True, lease=S)
    words = mismatches(offer, ask)
    assert len(words) == 5
    assert words[0].endswith("(let /a publish reliable, or /b request best effort)")
    assert words[1].startswith("/a publishes volatile and /b requests transient local")
    assert "requests a deadline of 1 s and /a offers 2 s" in words[2]
    assert "liveliness by topic" in words[3]
    assert "liveliness lease of 1 s" in words[4]
    assert mismatches(ask, offer) == []
    assert mismatches(offer, offer) == []
