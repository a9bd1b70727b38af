"""Messages that never arrive, and a publisher that misses its deadline, are in the status."""

from __future__ import annotations

import asyncio

import pytest

from backends.ros2.robot import Peer, Robot, fresh_domain, robot_of

pytestmark = pytest.mark.anyio
HEARING = {
    "/event/big": {
        "topic": "/big",
        "type": "std_msgs/msg/UInt8MultiArray",
        "qos": {"reliability": "best_effort", "deadline": 0.2},
    }
}


class Bursting(Peer):
    """A node that publishes more at once than arrives, and then nothing."""

    script = "bursting.py"

    async def burst(self) -> None:
        await asyncio.to_thread(self._ask, "")


async def test_lost_messages_and_a_missed_deadline_are_in_the_status() -> None:
    domain = fresh_domain()
    peer = Bursting(domain)
    peer.start()
    try:
        async with robot_of(domain, map=HEARING, grace=0.1, poll=0.1) as robot:
            await robot.until_async(
                peer.burst, lambda _: "messages of /big are lost" in told(robot)
            )
            assert "`reliable` QoS" in told(robot)
            await robot.until(lambda: "/big missed its deadline of 0.2 s" in told(robot))
            peer.stop()  # the subscription is made again without it, and nothing ends
            await robot.until_async(
                look, lambda _: not robot.backend.catalog.shared.graph.publishers.get("/big")
            )
    finally:
        peer.stop()


def told(robot: Robot) -> str:
    return (robot.reports or [""])[-1] or ""


async def look() -> None:
    """Look again."""
