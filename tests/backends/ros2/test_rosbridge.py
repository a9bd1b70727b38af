"""Clients of rosbridge and a real ROS 2 robot: the names, types and bytes are those of its nodes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

import rcp_ros2
from backends.ros2.robot import Peer, fresh_domain
from configuration import backend
from plugins.rosbridge.rig import OPEN, Page, Site, page, site
from plugins.rosbridge.test_clients import (
    port_of,
    roslib,
    roslib_offers,
    roslibpy,
    roslibpy_offers,
)

pytestmark = pytest.mark.anyio
DOMAIN = fresh_domain()
ROBOT = backend(
    "peer",
    use="ros2",
    domain_id=DOMAIN,
    expose=["/**", "/peer"],
    stop={"feedback": False},
    offers=True,
)
FACTS: dict[str, Any] = {
    "odom": "/odom",
    "cmd_vel": "/cmd_vel",
    "trigger": "/reset",
    "param": "/peer:max_speed",
    "value": 0.8,
    "action": {
        "name": "/fibonacci",
        "type": "test_msgs/action/Fibonacci",
        "goal": {"order": 4},
        "far": {"order": 40},
    },
}


@pytest.fixture(scope="module")
def robot() -> Iterator[Peer]:
    peer = Peer(DOMAIN, shared_memory=False)
    peer.start()
    yield peer
    peer.stop()


@pytest.fixture(scope="module")
async def gateway(robot: Peer) -> AsyncIterator[Site]:
    async with site(OPEN, ROBOT, kinds=tuple(rcp_ros2.rcp_backends())) as made:
        async with page(made) as first:
            await discovered(first)
        yield made


@pytest.fixture
async def client(gateway: Site) -> AsyncIterator[Page]:
    async with page(gateway) as made:
        yield made


async def discovered(client: Page) -> None:
    """Wait until the graph has all that the tests use."""
    async with asyncio.timeout(60):
        while True:
            topics = (await client.values("/rosapi/topics"))["topics"]
            services = (await client.values("/rosapi/services"))["services"]
            actions = (await client.values("/rosapi/action_servers"))["action_servers"]
            names = (await client.values("/rosapi/get_param_names"))["names"]
            if (
                {"/odom", "/cmd_vel", "/scan", "/imu"} <= set(topics)
                and "/reset" in services
                and "/fibonacci" in actions
                and "/peer:max_speed" in names
            ):
                return
            await asyncio.sleep(0.1)  # the graph is asked again


async def appears(client: Page, what: str, name: str) -> None:
    """Wait until the graph has a service, or an action server."""
    async with asyncio.timeout(60):
        while True:
            if name in (await client.values(f"/rosapi/{what}"))[what]:
                return
            await asyncio.sleep(0.1)  # the graph is asked again


async def test_the_graph_is_that_of_the_nodes(client: Page) -> None:
    found = await client.values("/rosapi/topics")
    types = dict(zip(found["topics"], found["types"], strict=True))
    assert types["/odom"] == "nav_msgs/msg/Odometry"
    assert types["/scan"] == "sensor_msgs/msg/LaserScan"
    assert types["/cmd_vel"] == "geometry_msgs/msg/Twist"
    service = await client.call("/rosapi/service_type", {"service": "/add"})
    assert service["values"]["type"] == "test_msgs/srv/BasicTypes"
    details = await client.call(
        "/rosapi/service_request_details", {"type": "test_msgs/srv/BasicTypes"}
    )
    request = details["values"]["typedefs"][0]
    fields = dict(zip(request["fieldnames"], request["fieldtypes"], strict=True))
    assert (fields["uint8_value"], fields["float32_value"]) == ("uint8", "float32")
    raw = (await client.values("/rosapi/topics_and_raw_types"))["typedefs_full_text"]
    assert any("float32 angle_increment" in text for text in raw)


async def test_messages_are_whole_and_the_numbers_json_can_have(client: Page) -> None:
    await client.send(op="subscribe", topic="/odom", type="nav_msgs/Odometry")
    odom = await client.message("/odom")
    assert set(odom) == {"header", "child_frame_id", "pose", "twist"}
    assert odom["header"]["frame_id"] == "odom"
    assert odom["pose"]["covariance"][0] is None  # infinite
    await client.send(op="subscribe", topic="/scan")
    assert (await client.message("/scan"))["ranges"][:3] == [1.0, None, None]


async def test_raw_messages_are_the_bytes_of_the_node(client: Page) -> None:
    from nav_msgs.msg import Odometry

    await client.send(op="subscribe", topic="/odom", compression="cbor-raw")
    message = await client.message("/odom")
    odom = deserialize_message(message["bytes"], Odometry)
    assert odom.header.frame_id == "odom"
    assert odom.header.stamp.sec == message["secs"]


async def test_a_velocity_arrives_at_the_node_and_its_zero_too(client: Page, robot: Peer) -> None:
    await client.send(op="subscribe", topic="/twist_heard")
    twist = {"linear": {"x": 0.25, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}

    async def publish() -> None:
        while True:
            await client.send(op="publish", topic="/cmd_vel", msg=twist)
            await asyncio.sleep(0.1)

    publishing = asyncio.create_task(publish())

    def heard(x: float) -> Any:
        return lambda m: m.get("topic") == "/twist_heard" and m["msg"]["linear"]["x"] == x

    await client.until(heard(0.25))
    publishing.cancel()
    await client.until(heard(0.0))  # the dead-man


async def test_services_with_their_arguments_by_name_and_in_order(client: Page) -> None:
    assert (await client.values("/reset"))["success"] is True
    named = await client.call("/set_bool", {"data": True})
    assert named["result"], named
    listed = await client.call("/set_bool", [False])
    assert listed["values"] == named["values"]
    again = await client.call("/set_bool", [False])
    assert again["result"] is True
    assert again["values"] == {"success": False, "message": "it is so already"}
    wrong = await client.call("/set_bool", {"nix": True})
    assert wrong["result"] is False
    slow = await client.call("/slow", {}, timeout=0.3)
    assert slow["result"] is False


async def test_a_goal_with_feedback(client: Page) -> None:
    await client.send(
        op="send_action_goal",
        id="g1",
        action="/fibonacci",
        action_type="test_msgs/action/Fibonacci",
        args={"order": 5},
        feedback=True,
    )
    await client.op("action_feedback", id="g1")
    result = await client.op("action_result", id="g1")
    assert result["status"] == 4
    assert result["values"]["sequence"][:3] == [0, 1, 1]


async def test_stamps_of_ros_1_are_understood(client: Page) -> None:
    twist = {"linear": {"x": 0.0}, "angular": {}, "header": {"stamp": {"secs": 1, "nsecs": 2}}}
    await client.send(op="publish", topic="/cmd_vel", msg=twist)
    assert "header" in (await client.status("/cmd_vel"))["msg"]  # a Twist has none


async def test_roslib(gateway: Site, tmp_path: Path) -> None:
    found = await roslib(tmp_path, gateway.url + "/rosbridge", "", FACTS)
    assert found["odom_type"] == "nav_msgs/msg/Odometry"
    assert found["cbor-raw"] > 700
    assert found["covariance"] == "Float64Array 36"
    assert found["trigger"]["success"] is True
    assert found["param"] == 0.8
    assert found["feedback"] > 0
    assert found["cancelled"]


async def test_roslibpy(gateway: Site) -> None:
    found = await roslibpy(gateway.port, FACTS)
    assert found["trigger"]["success"] is True
    assert found["param"] == 0.8
    assert found["status"] == "SUCCEEDED"
    assert found["connected"]


async def test_a_page_offers_a_service_on_the_graph(gateway: Site, client: Page) -> None:
    name, type_ = "/page/set", "std_srvs/srv/SetBool"
    async with page(gateway) as provider:
        await provider.send(op="advertise_service", service=name, type="my_msgs/srv/Missing")
        await provider.status("my_msgs")
        await provider.send(op="advertise_service", service="/reset", type="std_srvs/srv/Trigger")
        await provider.send(op="advertise_service", service=name, type=type_)
        await appears(client, "services", name)
        for result, values, told in (
            (True, {"success": True, "message": "done"}, {"success": True, "message": "done"}),
            (False, "no power", {"success": False, "message": "no power"}),
        ):
            await client.send(op="call_service", id="c", service=name, args={"data": True})
            call = await provider.op("call_service", service=name)
            assert call["args"] == {"data": True}
            mine = {"op": "service_response", "service": name, "id": call["id"]}
            await provider.send(**mine, values=values, result=result)
            response = await client.op("service_response", id="c")
            assert (response["result"], response["values"]) == (True, told)
        await client.send(op="call_service", id="d", service=name, args={"data": True})
        await provider.op("call_service", service=name)
    response = await client.op("service_response", id="d")
    assert "has gone" in str(response["values"])


async def test_a_page_offers_an_action_on_the_graph(gateway: Site, client: Page) -> None:
    name, type_ = "/page/count", "test_msgs/action/Fibonacci"
    async with page(gateway) as provider:
        await provider.send(op="advertise_action", action=name, type=type_)
        await appears(client, "action_servers", name)
        goal = {"op": "send_action_goal", "action": name, "feedback": True, "args": {"order": 3}}
        await client.send(**goal, id="g1")
        call = await provider.op("send_action_goal", action=name)
        assert call["args"] == {"order": 3}
        mine = {"action": name, "id": call["id"]}
        await provider.send(op="action_feedback", **mine, values={"sequence": [0, 1]})
        assert (await client.op("action_feedback", id="g1"))["values"] == {"sequence": [0, 1]}
        await provider.send(op="action_result", **mine, values={"sequence": [0, 1, 1]}, status=4)
        result = await client.op("action_result", id="g1")
        assert (result["values"], result["status"]) == ({"sequence": [0, 1, 1]}, 4)
        await client.send(**goal, id="g2")
        call = await provider.op("send_action_goal", action=name)
        await client.send(op="cancel_action_goal", action=name, id="g2")
        await provider.op("cancel_action_goal", id=call["id"])
        await provider.send(op="action_result", action=name, id=call["id"], values={}, status=5)
        assert (await client.op("action_result", id="g2"))["status"] == 5


async def test_roslib_and_roslibpy_offer_on_the_graph(tmp_path: Path, gateway: Site) -> None:
    await roslib_offers(tmp_path, gateway.url + "/rosbridge")
    await roslibpy_offers(port_of(gateway))


@contextmanager
def calling(name: str) -> Iterator[tuple[Callable[[], None], Callable[[], int]]]:
    """Yield what calls a service eight times at once, and what tells how many are answered by now."""
    context = Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    node = rclpy.create_node("caller", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    client = node.create_client(Trigger, name)
    assert client.wait_for_service(60)
    waiting: list[Any] = []

    def call() -> None:
        waiting.extend(client.call_async(Trigger.Request()) for _ in range(8))

    def answered() -> int:
        for _ in range(2 * len(waiting)):
            executor.spin_once(timeout_sec=0)
        return sum(future.done() for future in waiting)

    try:
        yield call, answered
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()


async def test_a_page_that_responds_to_nothing_holds_no_other_offer(
    gateway: Site, client: Page
) -> None:
    silent, prompt, type_ = "/page/silent", "/page/prompt", "std_srvs/srv/Trigger"
    async with page(gateway) as provider:
        for name in (silent, prompt):
            await provider.send(op="advertise_service", service=name, type=type_)
            await appears(client, "services", name)
        with calling(silent) as (call_eight, answered):
            for _ in range(2):  # the queue of a service holds ten
                call_eight()
                for _ in range(8):
                    await provider.op("call_service", service=silent)
            await client.send(op="call_service", id="p", service=prompt)
            call = await provider.op("call_service", service=prompt)
            values = {"success": True, "message": "here"}
            mine = {"op": "service_response", "service": prompt, "id": call["id"]}
            await provider.send(**mine, values=values, result=True)
            assert (await client.op("service_response", id="p"))["values"] == values
            assert answered() == 0  # all of them still wait
