"""What a command gets on its way: a stamp, a frame; and what only a mapping allows it to have."""

from __future__ import annotations

import math
import time
from collections.abc import AsyncIterator
from typing import Any

import msgspec
import pytest

from backends.ros2.robot import BOUND, Robot, fresh_domain, robot_of
from rcp_kernel.errors import RcpError
from rcp_kernel.values import Encoding, value_type
from rcp_ros2 import Ros2Config

pytestmark = pytest.mark.anyio
TWIST, POINT = "geometry_msgs/msg/TwistStamped", "my_msgs/msg/Setpoint"
TEXT = "std_msgs/Header header\nfloat32[3] position\nfloat32 yaw\n"
COMMANDS: dict[str, Any] = {
    "/actuator/twist": {"topic": "/twist", "type": TWIST, "frame": "base_link"},
    "/actuator/stamped": {"topic": "/stamped", "type": TWIST, "frame": "base_link"},
    "/actuator/point": {"topic": "/point", "type": POINT, "nan": True},
    "/actuator/free": {"topic": "/free", "type": POINT, "nan": True},
    "/actuator/strict": {"topic": "/strict", "type": POINT},
}
"""Each test has a topic: a subscription that is being left looks like the one that comes."""
SENSORS = {
    path.replace("actuator", "sensor"): {"topic": one["topic"], "type": one["type"]}
    for path, one in COMMANDS.items()
}


@pytest.fixture(scope="module")
async def pair() -> AsyncIterator[tuple[Robot, Robot]]:
    """A gateway that commands, and another one that hears it."""
    domain, types = fresh_domain(), {POINT: TEXT}
    hearing = robot_of(domain, map=SENSORS, node="hearing", types=types)
    async with robot_of(domain, map=COMMANDS, types=types) as robot, hearing as other:
        yield robot, other


async def heard(pair: tuple[Robot, Robot], name: str, plain: dict[str, Any]) -> Any:
    robot, other = pair
    sensor = f"sensor/{name}"
    async with other.backend.watch(sensor, None):
        await robot.until_async(
            _nothing, lambda _: robot.backend.catalog.shared.graph.subscribers.get(f"/{name}")
        )
        await robot.backend.write(f"actuator/{name}", robot.input(f"actuator/{name}", plain))
        await other.first(sensor)
        return other.of(sensor)[-1]


async def _nothing() -> None:
    pass


def age(message: Any) -> float:
    stamp = message.header.stamp
    return time.time() - stamp.sec - stamp.nanosec / 1e9


async def test_a_command_without_a_stamp_gets_one_and_its_frame(pair: tuple[Robot, Robot]) -> None:
    twist = await heard(pair, "twist", {"twist": {"linear": {"x": 0.5}}})
    assert -1.0 < age(twist) < BOUND
    assert (twist.header.frame_id, twist.twist.linear.x) == ("base_link", 0.5)


async def test_a_stamp_and_a_frame_that_are_given_stay(pair: tuple[Robot, Robot]) -> None:
    header = {"stamp": {"sec": 12, "nanosec": 5}, "frame_id": "tool"}
    twist = await heard(pair, "stamped", {"header": header})
    assert (twist.header.stamp.sec, twist.header.stamp.nanosec) == (12, 5)
    assert twist.header.frame_id == "tool"


async def test_a_type_that_is_not_installed_is_stamped_too(pair: tuple[Robot, Robot]) -> None:
    point = await heard(pair, "point", {"position": [1.0, 2.0, 3.0]})
    assert -1.0 < age(point) < BOUND
    assert list(point.position) == [1.0, 2.0, 3.0]


async def test_numbers_may_be_nan_where_the_mapping_says_so(pair: tuple[Robot, Robot]) -> None:
    robot, _ = pair
    body = b'{"position": ["NaN", 1.5, "-Infinity"], "yaw": 1e300}'
    free = value_type(robot.resources["actuator/free"].value)
    value = free.decode(body, Encoding.JSON)
    point = await heard(pair, "free", msgspec.to_builtins(value))
    assert math.isnan(point.position[0])
    assert list(point.position[1:]) == [1.5, -math.inf]
    assert point.yaw == math.inf
    strict = value_type(robot.resources["actuator/strict"].value)
    with pytest.raises(RcpError):
        strict.decode(body, Encoding.JSON)


@pytest.mark.parametrize("path", ["/sensor/a", "/event/a"])
def test_only_commands_have_the_key(path: str) -> None:
    plain = {"map": {path: {"topic": "/a", "nan": True}}}
    with pytest.raises(msgspec.ValidationError, match="`nan` is for actuators"):
        msgspec.convert(plain, Ros2Config)
