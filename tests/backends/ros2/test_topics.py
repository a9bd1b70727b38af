"""Topics: sensors, events and actuators."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest

from backends.ros2.robot import BOUND, Robot, robot_of
from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.spi import Publication
from rcp_kernel.values import Encoding, value_type

pytestmark = pytest.mark.anyio

UNASKED = {
    "/faults",
    "/parameter_events",
    "/odom",
    "/fibonacci/_action/status",
    "/robot_description",  # says what the robot is
}
"""What is subscribed to with nobody watching: an event, what parameters there are, and by what a
stop is confirmed: the odometry, and the goals of each action."""


async def test_a_watched_topic_is_published_with_the_time_of_its_header(robot: Robot) -> None:
    async with robot.backend.watch("sensor/odom", None):
        odom = await robot.first("sensor/odom")
    assert odom.header.frame_id == "odom"
    assert math.isinf(odom.pose.covariance[0])
    stamp = robot.samples[0][2]
    assert stamp == odom.header.stamp.sec * 10**9 + odom.header.stamp.nanosec
    assert abs(time.time_ns() - stamp) < BOUND * 1e9


async def test_a_topic_that_is_read_has_the_time_of_its_header(robot: Robot) -> None:
    found = await robot.backend.read("sensor/pose")
    assert isinstance(found, Publication)
    assert found.timestamp is not None
    assert abs(time.time_ns() - found.timestamp) < BOUND * 1e9
    assert found.value.orientation.w == 1.0


async def test_what_is_published_fits_the_declared_type_in_every_encoding(robot: Robot) -> None:
    async with robot.backend.watch("sensor/scan", None):
        scan = await robot.first("sensor/scan")
    declared = value_type(robot.resources["sensor/scan"].value)
    for encoding in Encoding:
        again = declared.decode(declared.encode(scan, encoding), encoding)
        assert again.ranges[:2] == [1.0, math.inf]
        assert math.isnan(again.ranges[2])


async def test_a_projection_is_the_part_and_keeps_the_time(robot: Robot) -> None:
    async with robot.backend.watch("sensor/pose", None):
        pose = await robot.first("sensor/pose")
    assert pose.orientation.w == 1.0
    assert pose.position.x > 0
    assert robot.samples[0][2] is not None
    schema = value_type(robot.resources["sensor/pose"].value).schema
    assert schema["$defs"]["Point"]["properties"]["x"]["unit"] == "m"


STOP = "feedback /odom None"


def _taps(subscriptions: Any) -> set[str]:
    return set(subscriptions.by_topic["/odom"].taps)


async def test_two_paths_on_one_topic_share_a_subscription_that_ends_with_the_last(
    robot: Robot,
) -> None:
    subscriptions = robot.backend.catalog.shared.subscriptions
    ros = robot.backend.catalog.shared.ros
    async with robot.backend.watch("sensor/odom", None):
        async with robot.backend.watch("sensor/pose", None):
            await robot.first("sensor/odom")
            await robot.first("sensor/pose")
            assert await ros.call(_taps, subscriptions) == {"sensor/odom", "sensor/pose", STOP}
            assert await ros.call(lambda: ros.node.count_subscribers("/odom")) == 1
        assert await ros.call(_taps, subscriptions) == {"sensor/odom", STOP}
    assert await ros.call(_taps, subscriptions) == {STOP}
    assert await ros.call(lambda: {s.topic_name for s in ros.node.subscriptions}) == UNASKED


async def test_a_topic_nobody_watches_is_not_subscribed(robot: Robot) -> None:
    ros = robot.backend.catalog.shared.ros
    assert await ros.call(lambda: {s.topic_name for s in ros.node.subscriptions}) == UNASKED


async def test_a_best_effort_publisher_is_heard(robot: Robot) -> None:
    async with robot.backend.watch("sensor/imu", None):
        imu = await robot.first("sensor/imu")
    assert imu.linear_acceleration.z == 9.81


async def test_a_latched_value_reaches_a_late_watcher_and_a_read(robot: Robot) -> None:
    async with robot.backend.watch("sensor/description", None):
        value = await robot.first("sensor/description")
        assert "peer_description" in value.data
        assert (await robot.read("sensor/description")).data == value.data


async def test_a_mismatch_of_qos_is_told_in_words(domain: int, peer: object) -> None:
    wrong = {"topic": "/imu", "qos": {"reliability": "reliable"}}
    async with robot_of(domain, map={"/sensor/imu": wrong}, grace=1.0) as robot:
        async with robot.backend.watch("sensor/imu", None):
            message = "/peer publishes best effort"
            await robot.until(lambda: robot.reports and message in (robot.reports[-1] or ""))
        await robot.until(lambda: robot.reports[-1] is None)


async def test_a_wanted_rate_is_kept_by_the_ros_side(robot: Robot) -> None:
    async with robot.backend.watch("sensor/odom", 10.0):
        await robot.until(lambda: len(robot.samples) >= 10)
    stamps = [stamp for _, _, stamp in robot.samples[:10]]
    span = (stamps[-1] - stamps[0]) / 1e9
    assert span > 0.45  # 0.9 s, or more if the machine is busy; 0.18 s as it is published


async def test_reading_a_topic_that_nobody_publishes_says_so(robot: Robot) -> None:
    nobody = {"/sensor/x": {"topic": "/x", "type": "std_msgs/msg/String"}}
    async with robot_of(99, map=nobody, grace=0.5) as r:
        with pytest.raises(AdapterUnavailable, match="no node publishes /x"):
            await r.read("sensor/x")


async def test_a_command_is_heard(robot: Robot) -> None:
    twist = robot.input("actuator/cmd_vel", {"linear": {"x": 0.5}})
    async with robot.backend.watch("sensor/heard", None):
        await robot.backend.write("actuator/cmd_vel", twist)
        await robot.until(lambda: any(t.linear.x == 0.5 for t in robot.of("sensor/heard")))


async def test_halt_publishes_zero_on_what_was_moving(robot: Robot) -> None:
    twist = robot.input("actuator/cmd_vel", {"angular": {"z": 0.25}})
    async with robot.backend.watch("sensor/heard", None):
        await robot.backend.write("actuator/cmd_vel", twist)
        await robot.until(lambda: any(t.angular.z == 0.25 for t in robot.of("sensor/heard")))
        await robot.backend.halt()
        await robot.until(lambda: robot.of("sensor/heard")[-1].angular.z == 0.0)


async def test_a_velocity_has_a_dead_man_by_itself(robot: Robot) -> None:
    resource = robot.resources["actuator/cmd_vel"]
    assert resource.valid_for == 0.5
    assert resource.safe.linear.x == 0.0
    assert value_type(resource.value).schema["$defs"]["Vector3_m_s"]["properties"]["x"]["unit"]


async def test_a_command_nobody_hears_is_refused(robot: Robot) -> None:
    value = robot.input("actuator/nobody", {"data": 1.0})
    with pytest.raises(AdapterUnavailable, match="the command would be lost"):
        await robot.backend.write("actuator/nobody", value)


async def test_an_event_comes_unasked(robot: Robot) -> None:
    assert robot.resources["event/fault"].live
    shared = robot.backend.catalog.shared
    matched = lambda: shared.ros.node.count_publishers("/faults")  # noqa: E731
    assert await shared.ros.call(matched)
    await robot.execute("service/fault")
    assert (await robot.first("event/fault")).data == "motor hot"
