"""What the profiles of a ROS 2 robot mean, with no map, as the process of a rover has it."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterator, Mapping
from contextlib import asynccontextmanager
from typing import Any, ClassVar

import pytest

import rcp_ros2
from backends.ros2 import interfaces
from backends.ros2.robot import BOUND, Wheels, fresh_domain
from rcp_gateway.testing import Body, ProfileSuite, eventually
from rcp_gateway.testing.backend._base import Robot

pytestmark = pytest.mark.skipif(not interfaces.have_tools(), reason="nav2_msgs cannot be built")
DOMAIN = fresh_domain()
PROFILES = ("mobile", "battery", "camera", "lidar", "power")


@pytest.fixture(scope="module")
def wheels() -> Iterator[Wheels]:
    rover = Wheels(DOMAIN, str(interfaces.built()), shared_memory=False)  # it is killed
    rover.start()
    yield rover
    rover.stop()


class TestRoverProfiles(ProfileSuite):
    kind = next(iter(rcp_ros2.rcp_backends()))
    config: ClassVar[Mapping[str, Any]] = {
        "domain_id": DOMAIN,
        "grace": 0.5,
        "timeout": 1.0,
        "silence": 1.5,
        "limits": {"speed": 0.8, "turn": 1.5},
    }
    profiles = PROFILES
    frame = "odom"
    cancel_within = 20.0
    complete_within = 40.0
    rover: Wheels

    @pytest.fixture(autouse=True)
    def _rover(self, wheels: Wheels) -> None:
        self.rover = wheels

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Any]:
        async with super().served_by_device() as robot:

            async def claims() -> bool:
                unknown = await robot.ask("read", "sensor/none")  # no longer "not yet"
                return self.claimed >= set(PROFILES) and not unknown["error"]["retryable"]

            # Discovery takes 0.2 s mostly and 3 s now and then: it is not what is tested.
            await eventually(claims, "the rover is discovered", BOUND)
            yield robot

    async def body(self) -> Body:
        truth = self.rover.tell("truth")
        at = {name: truth[name] for name in ("x", "y", "yaw")}
        return Body(**at, forward=truth["v"], yaw_rate=truth["w"])

    async def at_rest(self) -> bool:
        return not (await self.body()).moves and not self.rover.tell("truth")["running"]

    async def charge(self) -> float:
        return 0.75

    async def obstacle(self, bearing: float) -> float | None:
        return 3.0

    async def test_a_goal_that_the_navigator_refuses_is_rejected(self, robot: Robot) -> None:
        goal = {"position": {"x": 500.0, "y": 0.0}, "frame": "odom"}
        reply = await self.ask("execute", "action/move_to", body=goal)
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "device_rejected"), reply
        assert self.rover.tell("truth")["running"] == 0

    async def test_a_speed_for_one_goal_is_rejected(self, robot: Robot) -> None:
        goal = {"position": {"x": 0.0, "y": 0.0}, "frame": "odom", "speed": 0.2}
        reply = await self.ask("execute", "action/move_to", body=goal)
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "invalid_value"), reply

    async def test_velocities_beyond_the_limits_are_rejected(self, robot: Robot) -> None:
        for value in ({"linear": {"x": 0.9}}, {"linear": {"y": 0.1}}, {"angular": {"z": 1.6}}):
            reply = await self.ask("write", "actuator/cmd_vel", body=value)
            assert reply["error"]["code"] == "out_of_range", reply
        assert "actuator/velocity" not in robot.resources  # it would have no limits

    async def test_a_navigator_that_dies_fails_its_goal(self, robot: Robot) -> None:
        start = await self.body()
        goal = {"position": {"x": start.x + 20.0, "y": start.y}, "frame": "odom"}
        path = robot.path("action/move_to")
        id_ = await robot.client.send(type="execute", path=path, body=goal)

        async def moves() -> bool:
            return (await self.body()).moves

        await eventually(moves, "it moves", self.complete_within)
        self.rover.kill()
        final = await robot.client.final(id_, self.complete_within)
        assert final["status"] == "failed", final
        self.rover.start()
