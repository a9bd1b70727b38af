"""A peer that is killed, and comes back, while the gateway stays."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest

from backends.ros2.robot import BOUND, Peer, Robot, fresh_domain, robot_of
from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout
from rcp_ros2 import catalog

pytestmark = pytest.mark.anyio

MAP: dict[str, Any] = {
    "/sensor/odom": {"topic": "/odom"},
    "/action/fibonacci": {"action": "/fibonacci"},
    "/service/reset": {"service": "/reset", "timeout": 1.0},
    "/param/gear": {"node": "/peer", "parameter": "gear", "timeout": 1.0},
}


@pytest.fixture
def mortal() -> Iterator[tuple[int, Peer]]:
    domain = fresh_domain()
    peer = Peer(domain)
    peer.start()
    yield domain, peer
    peer.stop()


async def running(robot: Robot, order: int) -> asyncio.Future[Any]:
    """Start a goal and return when it moves."""
    moving = asyncio.Event()
    goal = robot.input("action/fibonacci", {"order": order})
    command = asyncio.ensure_future(
        robot.backend.execute("action/fibonacci", goal, lambda *_, **__: moving.set())
    )
    await asyncio.wait_for(moving.wait(), BOUND)
    await asyncio.sleep(0.6)  # until the first look after the server is past: it is alive then
    return command


async def test_a_peer_killed_in_the_middle_of_a_goal_is_noticed_and_works_again_when_it_is_back(
    mortal: tuple[int, Peer],
) -> None:
    domain, peer = mortal
    async with robot_of(domain, map=MAP, silence=2.0) as robot:
        command = await running(robot, 2000)
        peer.kill()
        with pytest.raises((AdapterUnavailable, DeviceTimeout)):
            await asyncio.wait_for(command, BOUND)

        with pytest.raises((AdapterUnavailable, DeviceTimeout)):
            await asyncio.wait_for(robot.execute("service/reset"), BOUND)

        peer.start()
        async with asyncio.timeout(BOUND):
            while True:
                try:
                    result = await robot.execute("action/fibonacci", {"order": 3})
                    break
                except (AdapterUnavailable, DeviceTimeout):
                    continue
        assert list(result.sequence) == [0, 1, 1, 2]
        assert (await robot.execute("service/reset")).success
        assert await robot.read("param/gear") == 2
        async with robot.backend.watch("sensor/odom", None):
            await robot.first("sensor/odom")


async def test_a_server_restarted_at_once_does_not_leave_the_goal_hanging(
    mortal: tuple[int, Peer],
) -> None:
    domain, peer = mortal
    async with robot_of(domain, map=MAP) as robot:
        command = await running(robot, 2000)
        peer.kill()
        peer.start()
        with pytest.raises((AdapterUnavailable, DeviceTimeout)):
            await asyncio.wait_for(command, BOUND)


async def test_a_peer_that_leaves_in_good_order_is_missed_at_once(
    mortal: tuple[int, Peer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(catalog, "_LINGER", 1.0)
    domain, peer = mortal
    async with robot_of(domain, expose=["/odom", "/peer"], map=MAP) as robot:
        await robot.until(lambda: "param/peer/max_speed" in robot.resources)
        assert "sensor/odom" in robot.resources
        peer.stop()
        await robot.until(lambda: any(robot.reports))
        async with asyncio.timeout(60):
            with pytest.raises(AdapterUnavailable, match="no node offers service /reset"):
                await robot.execute("service/reset")
            with pytest.raises(AdapterUnavailable, match="no node offers action"):
                await robot.execute("action/fibonacci", {"order": 3})
        await robot.until(lambda: "param/peer/max_speed" not in robot.resources)
        assert "sensor/odom" in robot.resources  # it is mapped, so that it stays
        peer.start()
        await robot.until(lambda: "param/peer/max_speed" in robot.resources)
        await robot.until(lambda: robot.reports[-1] is None)
