"""Values and goals of a ROS 2 robot in other frames, through TF of living nodes."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

import rcp_ros2
from backends.ros2 import interfaces
from backends.ros2.robot import BOUND, RobotNodes, Wheels, fresh_domain
from configuration import backend, key, table
from rcp_gateway.testing import MemoryClient, eventually, serve
from rcp_gateway.testing._serve import OPERATOR
from rcp_geometry import ecef, geodetic, local

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(not interfaces.have_tools(), reason="nav2_msgs cannot be built"),
]
DOMAIN = fresh_domain()
YARD = (48.137154, 11.576124, 519.0)
HALF = math.sqrt(0.5)
CONFIG = (
    backend(
        tenant="t",
        use="ros2",
        domain_id=DOMAIN,
        expose=["/odom", "/tf", "/tf_static", "/cmd_vel", "/navigate_to_pose"],
    )
    + table("features.frames", max_age=10)
    + table(
        'features.frames.anchors."/tenant/t"', latitude=YARD[0], longitude=YARD[1], altitude=YARD[2]
    )
    + key("operator", OPERATOR, roles={"*": ["operator"]})
)


@pytest.fixture(scope="module")
def nodes() -> Iterator[tuple[Wheels, RobotNodes]]:
    wheels = Wheels(DOMAIN, str(interfaces.built()), shared_memory=False)
    others = RobotNodes(DOMAIN, shared_memory=False)
    wheels.start()
    others.start()
    # The map is 10 m away from where odometry began, and looks to the right of it.
    others.tell("fix", by="base", parent="map", child="odom", place=[10, 0, 0, 0, 0, HALF, HALF])
    yield wheels, others
    others.stop()
    wheels.stop()


@pytest.fixture
async def client(nodes: tuple[Wheels, RobotNodes]) -> AsyncIterator[MemoryClient]:
    async with serve(CONFIG, *rcp_ros2.rcp_backends()) as served:
        client = served.client(OPERATOR)
        await until(client, "sensor/pose", "earth")
        await until(client, "sensor/velocity", "map")
        yield client


async def until(client: MemoryClient, name: str, frame: str) -> None:
    """Wait until the robot and its transforms are discovered."""

    async def found() -> bool:
        return "error" not in await read(client, name, frame)

    await eventually(found, f"{name} is known in {frame}", BOUND)


async def read(client: MemoryClient, name: str, frame: str) -> Any:
    return await client.request("read", f"/tenant/t/{name}", body={"frame": frame, "fresh": True})


def in_map(truth: dict[str, float]) -> tuple[float, float]:
    return 10 - truth["y"], truth["x"]


async def test_a_pose_is_read_through_tf(
    client: MemoryClient, nodes: tuple[Wheels, RobotNodes]
) -> None:
    truth = nodes[0].tell("truth")
    pose = (await read(client, "sensor/pose", "map"))["body"]
    assert pose["frame_id"] == "map"
    assert (pose["position"]["x"], pose["position"]["y"]) == pytest.approx(in_map(truth), abs=0.05)
    place = (await read(client, "sensor/pose", "earth"))["body"]["position"]
    there = local(*YARD).inverse.point(ecef(*place.values()))
    assert there[:2] == pytest.approx(in_map(truth), abs=0.05)


async def test_goals_are_converted_to_the_frame_of_its_pose(
    client: MemoryClient, nodes: tuple[Wheels, RobotNodes]
) -> None:
    wheels, _ = nodes
    before = wheels.tell("truth")
    for goal, x, y in (
        ({"position": {"x": 1.0, "y": 0.0}, "frame": "base_link"}, None, None),
        ({"position": {"x": 9.5, "y": 0.5}, "frame": "map"}, 9.5, 0.5),
        ({"position": place(10.0, 1.0), "frame": "earth"}, 10.0, 1.0),
    ):
        path = "/tenant/t/action/move_to"
        reply = await client.request("execute", path, body=goal, within=60.0)
        assert reply["status"] == "completed", reply
        truth = wheels.tell("truth")
        if x is None:
            ahead = before["x"] + math.cos(before["yaw"]), before["y"] + math.sin(before["yaw"])
            assert (truth["x"], truth["y"]) == pytest.approx(ahead, abs=0.15)
        else:
            assert in_map(truth) == pytest.approx((x, y), abs=0.15)


def place(x: float, y: float) -> dict[str, float]:
    latitude, longitude, _ = geodetic(local(*YARD).point((x, y, 0.0)))
    return {"latitude": latitude, "longitude": longitude}


async def test_an_old_transform_converts_nothing(
    client: MemoryClient, nodes: tuple[Wheels, RobotNodes]
) -> None:
    old = time.time_ns() - 60 * 10**9
    cart = [1, 0, 0, 0, 0, 0, 1]
    async with asyncio.timeout(BOUND):
        while True:
            nodes[1].tell("move", parent="odom", child="cart", time=old, place=cart)
            reply = await read(client, "sensor/pose", "cart")
            if reply["error"]["code"] != "invalid_value":
                break
            await asyncio.sleep(0.1)
    assert reply["error"]["code"] == "precondition_failed"
    assert reply["error"]["details"]["age"] > 50
