"""A client of FollowJointTrajectory on the graph drives motors on CAN, by the example program."""

from __future__ import annotations

import asyncio
import importlib.util
import itertools
import sys
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import ModuleType
from typing import Any

import pytest

import rcp_can
import rcp_client
import rcp_ros2
from backends.ros2 import interfaces
from backends.ros2.robot import fresh_domain
from configuration import backend, key, listener
from docs.pages import ROOT
from rcp_gateway.testing import eventually, serve
from rcp_gateway.testing._serve import OPERATOR
from rcp_kernel.config.file import parse
from rcp_kernel.errors import AdapterUnavailable

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(not interfaces.have_tools(), reason="control_msgs cannot be built"),
]
NAME = "/arm_controller/follow_joint_trajectory"
MOTOR = {
    "bus": "can0", "profile": "cia402", "velocity": 3.0, "acceleration": 20.0, "watchdog": 10.0,
    "timeout": 2.0, "feedback_timeout": 2.0, "options": {"heartbeat": 300},
}  # fmt: skip
_NUMBERS = itertools.count()


def program() -> ModuleType:
    """Return the example as a module."""
    path = ROOT / "examples" / "moveit_arm.py"
    spec = importlib.util.spec_from_file_location("moveit_arm", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["moveit_arm"] = module
    spec.loader.exec_module(module)
    return module


class MoveIt:
    """A client on the graph, with a thread of its own."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from control_msgs.action import FollowJointTrajectory
        from rclpy.action import ActionClient
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import JointState

        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("move_group", context=self.context)
        self.action = FollowJointTrajectory
        self.client = ActionClient(self.node, FollowJointTrajectory, NAME)
        self.states: list[Any] = []
        self.node.create_subscription(JointState, "/joint_states", self.states.append, 10)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin, daemon=True)
        self.thread.start()

    def close(self) -> None:
        self.executor.shutdown()
        self.thread.join(10)
        self.client.destroy()
        self.node.destroy_node()
        self.context.try_shutdown()

    async def goal(self, *points: tuple[float, float, float]) -> Any:
        """Send a goal by (time, shoulder, elbow); return its handle once it is accepted."""
        goal = self.action.Goal()
        goal.trajectory.joint_names = ["shoulder", "elbow"]
        for at, *places in points:
            from trajectory_msgs.msg import JointTrajectoryPoint

            point = JointTrajectoryPoint(positions=places, velocities=[0.0, 0.0])
            point.time_from_start.sec = int(at)
            point.time_from_start.nanosec = round(at % 1 * 1e9)
            goal.trajectory.points.append(point)
        found = await asyncio.to_thread(self.client.wait_for_server, 30)
        assert found
        handle = await _done(self.client.send_goal_async(goal))
        assert handle.accepted
        return handle


async def _done(future: Any) -> Any:
    """Wait for a future of rclpy."""
    async with asyncio.timeout(60):
        while not future.done():  # noqa: ASYNC110  # its thread tells no event loop
            await asyncio.sleep(0.005)
    return future.result()


@asynccontextmanager
async def bridged() -> AsyncIterator[tuple[MoveIt, rcp_client.Client]]:
    """Run a gateway with an arm on CAN and a graph, the program, and a client on the graph."""
    interfaces.built()
    domain, moveit_arm = fresh_domain(), program()
    bus = {"interface": "virtual", "channel": f"moveit-{next(_NUMBERS)}", "simulate": True}
    motors = {"shoulder": {**MOTOR, "node": 3}, "elbow": {**MOTOR, "node": 4}}
    group = {"joints": ["shoulder", "elbow"], "as_robot": True}
    arm = backend(
        "arm",
        tenant="cell",
        use="can",
        buses={"can0": bus},
        motors=motors,
        joint_groups={"arm": group},
    )
    states = {"topic": "/joint_states", "type": "sensor_msgs/msg/JointState", "moves": False}
    states |= {"valid_for": 0, "require_subscriber": False}
    graph = backend(
        "graph",
        tenant="graph",
        use="ros2",
        domain_id=domain,
        offers=True,
        grace=0.5,
        stop={"feedback": False},
        map={"actuator/joint_states": states},
    )
    text = arm + graph + listener() + key("operator", OPERATOR)
    kinds = (*rcp_can.rcp_backends(), *rcp_ros2.rcp_backends())
    async with serve(parse(text, "test"), *kinds) as served:
        url = next(f["url"] for f in served.server.status.transports if "url" in f)
        async with rcp_client.connect(url, token=OPERATOR) as client:
            await eventually(lambda: done(client, "/tenant/cell/service/enable"), "enabled", 60)
            bridge = moveit_arm.Bridge(client, "/tenant/cell", "/tenant/graph")
            tasks = [asyncio.create_task(work) for work in (bridge.serve(NAME), bridge.tell())]
            moveit = MoveIt(domain)
            try:
                yield moveit, client
            finally:
                moveit.close()
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)


async def done(client: rcp_client.Client, path: str) -> bool:
    """Execute what may not be there yet."""
    try:
        await client.execute(path)
    except AdapterUnavailable:
        return False
    return True


async def places(client: rcp_client.Client) -> list[float]:
    return (await client.read("/tenant/cell/sensor/joint_states"))["position"]


async def told(moveit: MoveIt, place: float) -> bool:
    return bool(moveit.states) and abs(moveit.states[-1].position[0] - place) < 0.03


async def beyond_place(client: rcp_client.Client, place: float) -> bool:
    return (await places(client))[0] > place


async def test_a_trajectory_of_the_graph_moves_an_arm_on_can() -> None:
    async with bridged() as (moveit, client):
        handle = await moveit.goal((0.5, 0.2, -0.1), (1.0, 0.4, -0.2))
        answer = await _done(handle.get_result_async())
        assert (answer.status, answer.result.error_code) == (4, 0)  # succeeded
        assert await places(client) == pytest.approx([0.4, -0.2], abs=0.03)
        await eventually(lambda: told(moveit, 0.4), "the graph is told where the joints are")
        assert list(moveit.states[-1].name) == ["shoulder", "elbow"]

        beyond = await moveit.goal((0.01, 2.0, 2.0))  # faster than the joints are
        answer = await _done(beyond.get_result_async())
        assert (answer.status, answer.result.error_code) == (6, -1)  # aborted
        assert "acceleration of joint" in answer.result.error_string
        assert await places(client) == pytest.approx([0.4, -0.2], abs=0.03)

        long = await moveit.goal((30.0, 2.0, -2.0))
        await eventually(lambda: beyond_place(client, 0.42), "it moves")
        await _done(long.cancel_goal_async())
        answer = await _done(long.get_result_async())
        assert answer.status == 5  # cancelled, and at rest
        here = await places(client)
        speeds = (await client.read("/tenant/cell/sensor/joint_states"))["velocity"]
        assert max(map(abs, speeds)) < 0.05
        assert here[0] < 1.0
