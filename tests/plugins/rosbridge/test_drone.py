"""A MAVLink drone, flown by what a page for ROS robots sends."""

from __future__ import annotations

from typing import Any

from configuration import backend, table
from plugins.rosbridge.rig import OPEN, Page, page, site

BOUND = 60.0  # s: the vehicle starts, climbs and moves in its own time
DRONE = backend("drone", use="mavlink", links=["sim:copter"]) + table("backends.twin", warmup=0.5)


async def until_topics(client: Page, *wanted: str) -> dict[str, str]:
    """Wait until a robot has these topics; return the types of all."""
    for topic in wanted:
        await client.send(op="subscribe", topic=topic, throttle_rate=100, queue_length=1)
    for topic in wanted:
        await client.until(lambda m, t=topic: m.get("topic") == t, BOUND)
    found = await client.values("/rosapi/topics")
    return dict(zip(found["topics"], found["types"], strict=True))


async def goal(client: Page, action: str, **args: Any) -> dict[str, Any]:
    """Send a goal and return its result."""
    await client.send(op="send_action_goal", id=action, action=action, args=args)
    return await client.until(lambda m: m["op"] == "action_result" and m["action"] == action, BOUND)


async def armed(client: Page) -> None:
    """Arm as soon as the vehicle's own checks allow it."""
    for _ in range(100):
        result = await goal(client, "/arm")
        if result["result"]:
            return
    raise AssertionError(result)


def _has_fix(message: dict[str, Any]) -> bool:
    """Tell whether a vehicle that has just started knows its position."""
    return message["msg"]["latitude"] is not None


async def test_a_page_for_ros_robots_flies_a_drone() -> None:
    async with site(OPEN, DRONE) as gateway, page(gateway) as client:
        types = await until_topics(client, "/odom", "/imu/data", "/fix", "/battery_state")
        assert types["/fix"] == "sensor_msgs/msg/NavSatFix"
        assert types["/cmd_vel"] == "geometry_msgs/msg/Twist"
        fix = await client.until(lambda m: m.get("topic") == "/fix" and _has_fix(m), BOUND)
        assert abs(fix["msg"]["latitude"]) > 1
        await armed(client)
        risen = await goal(client, "/takeoff", altitude=4.0)
        assert risen["result"], risen
        east = {"linear": {"x": 1.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
        client._received.clear()  # noqa: SLF001 - what was before

        def speed(message: dict[str, Any]) -> float:
            if message.get("topic") != "/odom":
                return 0.0
            linear = message["msg"]["twist"]["twist"]["linear"]
            return (linear["x"] ** 2 + linear["y"] ** 2) ** 0.5

        for _ in range(200):
            await client.send(op="publish", topic="/cmd_vel", msg=east)
            if speed(await client.until(lambda m: m.get("topic") == "/odom", BOUND)) > 0.5:
                break
        else:
            raise AssertionError("it did not move")
        # It stops when the page publishes no more.
        await client.until(lambda m: m.get("topic") == "/odom" and speed(m) < 0.2, BOUND)
