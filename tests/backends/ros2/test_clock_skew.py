"""Stamps that the gateway's clock does not explain."""

from __future__ import annotations

import pytest

from backends.ros2.robot import Robot, fresh_domain, robot_of

pytestmark = pytest.mark.anyio
TYPE = "geometry_msgs/msg/PointStamped"
SENDING = {"/actuator/point": {"topic": "/point", "type": TYPE}}
HEARING = {"/sensor/point": {"topic": "/point", "type": TYPE}}


async def test_stamps_that_are_off_are_in_the_status_until_they_are_right() -> None:
    domain = fresh_domain()
    hearing = robot_of(domain, map=HEARING, node="hearing", grace=0.1)
    async with robot_of(domain, map=SENDING) as sender, hearing as other:

        async def send(second: int) -> list[str | None]:
            header = {"stamp": {"sec": second}}
            await sender.backend.write(
                "actuator/point", sender.input("actuator/point", {"header": header})
            )
            return other.reports

        def told(robot: Robot) -> str:
            return (robot.reports or [""])[-1] or ""

        async with other.backend.watch("sensor/point", None):
            graph = sender.backend.catalog.shared
            await sender.until_async(_pause, lambda _: graph.graph.subscribers.get("/point"))
            await other.until_async(lambda: send(1000), lambda _: "behind" in told(other))
            assert "/point" in told(other)
            await other.until_async(
                lambda: send(2_000_000_000), lambda _: "ahead of" in told(other)
            )
            await other.until_async(lambda: send(0), lambda _: "stamps" not in told(other))


async def _pause() -> None:
    """Look again at the graph."""
