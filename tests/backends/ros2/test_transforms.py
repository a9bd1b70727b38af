"""`/tf` and `/tf_static` of living nodes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest

from backends.ros2.robot import BOUND, Robot, RobotNodes, fresh_domain, robot_of
from rcp_kernel.errors import DeviceRejected, InvalidValue, OutOfRange
from rcp_kernel.values import Encoding, value_type
from rcp_ros2.definitions import TF_MESSAGE
from rcp_ros2.idl import fields_of, load
from rcp_ros2.support import type_hash

pytestmark = pytest.mark.anyio

LOOKUP = "service/lookup_transform"
CAMERA = "sensor/tf/odom/camera"
S = 1_000_000_000


def test_the_type_has_the_hash_that_all_others_know_it_by() -> None:
    cls = load(TF_MESSAGE)
    known = "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
    assert type_hash(TF_MESSAGE, fields_of(cls)).hex() == known


def test_a_hash_is_the_one_that_the_generated_code_has() -> None:
    from geometry_msgs.msg import TransformStamped

    known = "0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206"
    found = type_hash("geometry_msgs/msg/TransformStamped", fields_of(TransformStamped))
    assert found.hex() == known


@pytest.fixture(scope="module")
def casters() -> Iterator[tuple[int, RobotNodes]]:
    domain = fresh_domain()
    robot_nodes = RobotNodes(domain)
    robot_nodes.start()
    yield domain, robot_nodes
    robot_nodes.stop()


def stand(robot_nodes: RobotNodes) -> int:
    """Two nodes say what stands for ever, one of them where the base is; return its last time."""
    robot_nodes.tell(
        "fix", by="base", parent="base_link", child="camera", place=[0, 0, 1, 0, 0, 0, 1]
    )
    robot_nodes.tell(
        "fix", by="arm", parent="camera", child="lens/left", place=[0, 1, 0, 0, 0, 0, 1]
    )
    now = time.time_ns()
    for tenth in range(11):
        place = [tenth / 10, 0, 0, 0, 0, 0, 1]
        stamp = now - S + tenth * S // 10
        robot_nodes.tell("move", parent="odom", child="base_link", time=stamp, place=place)
    return now


@pytest.fixture
async def framed(casters: tuple[int, RobotNodes]) -> AsyncIterator[tuple[Robot, RobotNodes, int]]:
    domain, robot_nodes = casters
    if not robot_nodes.runs:
        robot_nodes.start()
    async with robot_of(domain, expose=["/tf", "/tf_static"]) as robot:
        await robot.until(lambda: LOOKUP in robot.resources)
        now = 0

        def stood() -> bool:
            nonlocal now
            if {CAMERA, "sensor/tf/odom/lens.left"} <= robot.resources.keys():
                frames = robot.backend.catalog.bindings[CAMERA].tree.frames
                if frames.lookup("odom", "camera")[1] == now:
                    return True
            now = stand(robot_nodes)
            return False

        await repeated(robot, stood)
        yield robot, robot_nodes, now


async def repeated(robot: Robot, once: Callable[[], bool]) -> None:
    """Do something until it is heard: nothing tells a publisher whom it has found.

    Each time it is waited for longer: on a busy machine it is heard after the next one was said.
    """
    pause = 0.1
    async with asyncio.timeout(BOUND):
        while not once():
            with suppress(TimeoutError):
                await robot.until(lambda: False, pause)
            pause *= 2


async def lookup(robot: Robot, target: str, source: str, at: float | None = None) -> Any:
    asked = {"target": target, "source": source, "time": at}
    return await robot.execute(LOOKUP, asked)


async def test_a_frame_is_read_in_one_that_matters(framed: tuple[Robot, RobotNodes, int]) -> None:
    robot, _, now = framed
    value = await robot.read(CAMERA)
    moved = value.transform.translation
    assert (moved.x, moved.y, moved.z) == (1.0, 0.0, 1.0)
    assert value.header.stamp.sec * S + value.header.stamp.nanosec == now
    declared = value_type(robot.resources[CAMERA].value)
    assert declared.encode(value, Encoding.JSON)
    text = str(declared.schema)
    assert "REP-105" in text
    assert "'m'" in text
    assert "'odom'" in text


async def test_what_several_nodes_say_stands_for_ever_reaches_one_that_comes_late(
    framed: tuple[Robot, RobotNodes, int], casters: tuple[int, RobotNodes]
) -> None:
    domain, _ = casters
    names = {"/sensor/lens": ["base_link", "lens/left"]}
    async with robot_of(domain, expose=["/tf_static"], tf={"names": names}, node="late") as late:
        await late.until(lambda: "sensor/tf/base_link/lens.left" in late.resources)
        value = await late.read("sensor/tf/base_link/lens.left")
        assert (await late.read("sensor/lens")).transform == value.transform
        moved = value.transform.translation
        assert (moved.x, moved.y, moved.z) == (0.0, 1.0, 1.0)


async def test_a_pair_is_told_as_it_moves(framed: tuple[Robot, RobotNodes, int]) -> None:
    robot, robot_nodes, now = framed
    async with robot.backend.watch(CAMERA, 50.0):
        assert (await robot.first(CAMERA)).transform.translation.x == 1.0
        there = [2.0, 0, 0, 0, 0, 0, 1]
        robot_nodes.tell("move", parent="odom", child="base_link", time=now + S, place=there)
        await robot.until(lambda: robot.of(CAMERA)[-1].transform.translation.x == 2.0)
    assert [stamp for _, _, stamp in robot.samples] == [now, now + S]


async def test_a_lookup_at_a_time_is_interpolated(framed: tuple[Robot, RobotNodes, int]) -> None:
    robot, _, now = framed
    value = await lookup(robot, "odom", "lens/left", (now - S // 20) / S)
    assert abs(value.transform.translation.x - 0.95) < 1e-4
    assert value.child_frame_id == "lens/left"
    back = await lookup(robot, "lens/left", "odom")
    assert back.transform.translation.x == -1.0


async def test_a_lookup_that_cannot_be_says_why(framed: tuple[Robot, RobotNodes, int]) -> None:
    robot, robot_nodes, now = framed
    with pytest.raises(InvalidValue, match="there is no frame 'camra'") as unknown:
        await lookup(robot, "odom", "camra")
    assert "camera" in unknown.value.remedy
    with pytest.raises(OutOfRange, match=r"base_link.*after that") as late:
        await lookup(robot, "odom", "camera", now / S + 60)
    assert late.value.details is not None
    assert late.value.details["last"] > late.value.details["first"]
    robot_nodes.tell("fix", by="arm", parent="table", child="cup", place=[0, 0, 0, 0, 0, 0, 1])
    await robot.until(lambda: "sensor/tf/table/cup" in robot.resources)
    with pytest.raises(DeviceRejected, match="are not connected"):
        await lookup(robot, "odom", "cup")


async def test_casters_that_are_killed_and_come_back_go_on(
    framed: tuple[Robot, RobotNodes, int],
) -> None:
    robot, robot_nodes, _ = framed
    async with robot.backend.watch(CAMERA, None):
        await robot.first(CAMERA)
        robot_nodes.kill()
        assert (await robot.read(CAMERA)).transform.translation.z == 1.0
        robot_nodes.start()

        def moved() -> bool:
            there = [5.0, 0, 0, 0, 0, 0, 1]
            stamp = time.time_ns()
            robot_nodes.tell("move", parent="odom", child="base_link", time=stamp, place=there)
            return robot.of(CAMERA)[-1].transform.translation.x == 5.0

        await repeated(robot, moved)
