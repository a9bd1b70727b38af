"""What the profile `arm` of a ROS 2 robot means, with no map, as the process of an arm has it."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterator, Mapping
from contextlib import asynccontextmanager
from typing import Any, ClassVar

import pytest

import rcp_ros2
from backends.ros2 import interfaces
from backends.ros2.robot import BOUND, Jointed, fresh_domain, robot_of
from rcp_gateway.testing import ProfileSuite, eventually
from rcp_gateway.testing.backend._base import Robot
from rcp_kernel.values import value_type

pytestmark = pytest.mark.skipif(not interfaces.have_tools(), reason="control_msgs cannot be built")
DOMAIN = fresh_domain()
LEFT = ("left_shoulder", "left_elbow")
_SAMPLES = 8
MOVE, FOLLOW = "action/move_joints", "action/follow_trajectory"


@pytest.fixture(scope="module")
def arm() -> Iterator[Jointed]:
    device = Jointed(DOMAIN, str(interfaces.built()), shared_memory=False)  # it is killed
    device.start()
    yield device
    device.stop()


class TestArmProfile(ProfileSuite):
    kind = next(iter(rcp_ros2.rcp_backends()))
    config: ClassVar[Mapping[str, Any]] = {
        "domain_id": DOMAIN,
        "grace": 0.5,
        "timeout": 2.0,
        "silence": 1.5,
    }
    profiles = ("arm",)
    cancel_within = 20.0
    complete_within = 40.0
    jointed: Jointed

    @pytest.fixture(autouse=True)
    def _device(self, arm: Jointed) -> Iterator[None]:
        self.jointed = arm
        yield
        if arm.runs:
            arm.tell("set", stuck=None, tolerance=0.2, braking=6.0)
            arm.tell("tell_speeds", told=True)
            arm.tell("tell_late", delay=0.0)

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Any]:
        async with super().served_by_device() as robot:
            parts: dict[str, bool] = {}

            async def claims() -> bool:
                unknown = await robot.ask("read", "sensor/none")
                found = robot.resources.get(FOLLOW)
                parts["no longer 'not yet'"] = not unknown["error"]["retryable"]
                parts["claimed"] = "arm" in self.claimed
                parts["limits"] = found is not None and "maximum" in str(
                    value_type(found.input).schema
                )
                return all(parts.values())

            try:
                await eventually(claims, "the arm is discovered", BOUND)
            except AssertionError as error:
                raise AssertionError(f"{error}: {parts}, {sorted(robot.resources)}") from None
            yield robot

    async def joints(self) -> Mapping[str, float]:
        return self.jointed.tell("truth")["joints"]

    async def at_rest(self) -> bool:
        truth = self.jointed.tell("truth")
        return truth["speed"] < 0.05 and not truth["running"]

    async def far(self) -> dict[str, float]:
        """Return a goal that takes long."""
        here = (await self.joints())["shoulder"]
        return {"shoulder": -1.9 if here > 0 else 1.9}

    async def begun(
        self, robot: Robot, goal: dict[str, float], speed: float = 0.4, moving: float = 0.15
    ) -> str:
        """Start a long motion; return its id."""
        id_ = await robot.client.send(
            type="execute", path=robot.path(MOVE), body={"positions": goal, "speed": speed}
        )

        async def moves() -> bool:
            return self.jointed.tell("truth")["speed"] > moving

        await eventually(moves, "it moves", self.complete_within)
        return id_

    async def test_positions_beyond_the_description_are_rejected(self, robot: Robot) -> None:
        reply = await self.ask("execute", MOVE, body={"positions": {"shoulder": 2.1}})
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "out_of_range"), reply

    async def test_a_trajectory_that_is_too_fast_is_rejected(self, robot: Robot) -> None:
        there = (await self.far())["shoulder"]
        points = [{"time": 0.5, "positions": {"shoulder": there}}]
        goals = self.jointed.tell("truth")["goals"]
        reply = await self.ask("execute", FOLLOW, body={"points": points})
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "out_of_range"), reply
        assert self.jointed.tell("truth")["goals"] == goals

    async def test_times_that_do_not_increase_are_rejected(self, robot: Robot) -> None:
        points = [{"time": 2.0, "positions": {"shoulder": 0.0}}] * 2
        reply = await self.ask("execute", FOLLOW, body={"points": points})
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "invalid_value"), reply

    async def test_a_goal_that_the_controller_refuses_is_rejected(self, robot: Robot) -> None:
        moving = {"time": 3.0, "positions": {"shoulder": 0.0}, "velocities": {"shoulder": 0.3}}
        reply = await self.ask("execute", FOLLOW, body={"points": [moving]})
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "device_rejected"), reply

    async def test_a_controller_s_success_is_not_believed_unless_the_joints_are_there(
        self, robot: Robot
    ) -> None:
        goal = await self.far()
        self.jointed.tell("set", stuck="shoulder", tolerance=9.0)
        reply = await self.ask("execute", MOVE, body={"positions": goal})
        assert (reply["status"], reply["error"]["code"]) == ("failed", "device_rejected"), reply
        assert "shoulder" in reply["error"]["message"]

    async def test_a_joint_that_lags_fails_the_goal_with_the_reason(self, robot: Robot) -> None:
        goal = await self.far()
        self.jointed.tell("set", stuck="shoulder")
        reply = await self.ask("execute", MOVE, body={"positions": goal})
        assert reply["status"] == "failed", reply
        assert "path tolerance" in reply["error"]["message"]

    @pytest.mark.parametrize("told", [True, False])
    async def test_a_cancel_ends_when_the_joints_are_at_rest(
        self, robot: Robot, *, told: bool
    ) -> None:
        self.jointed.tell("tell_speeds", told=told)
        self.jointed.tell("set", braking=1.0)  # the controller's word comes long before
        id_ = await self.begun(robot, await self.far(), 0.8)
        await robot.ask("cancel", MOVE)
        final = await robot.client.final(id_, self.complete_within)
        assert final["status"] == "cancelled", final
        assert self.jointed.tell("truth")["speed"] < 0.1

    async def test_a_cancel_is_not_ended_by_joint_states_from_before_the_motion(
        self, robot: Robot
    ) -> None:
        await robot.ask("read", "sensor/joint_states")
        goal = {"shoulder": (await self.far())["shoulder"]}
        await self.do("execute", MOVE, body={"positions": {"elbow": 0.1}})  # it knows the clock
        self.jointed.tell("set", braking=0.5)
        self.jointed.tell("tell_late", delay=1.0)
        id_ = await self.begun(robot, goal, 0.8, 0.5)
        await robot.ask("cancel", MOVE)
        final = await robot.client.final(id_, self.complete_within)
        assert final["status"] == "cancelled", final
        assert self.jointed.tell("truth")["speed"] < 0.1

    async def test_a_stop_is_confirmed_when_the_joints_are_at_rest(self, robot: Robot) -> None:
        self.jointed.tell("set", braking=1.5)
        id_ = await self.begun(robot, await self.far(), 0.8, 0.7)
        await robot.backend.halt()
        assert self.jointed.tell("truth")["speed"] < 0.15
        assert (await robot.client.final(id_, self.complete_within))["status"] == "cancelled"

    async def test_a_second_goal_takes_the_arm_from_the_first(self, robot: Robot) -> None:
        id_ = await self.begun(robot, await self.far())
        points = [{"time": 3.0, "positions": {"shoulder": 0.0}}]
        await self.do("execute", FOLLOW, body={"points": points})
        first = await robot.client.final(id_, self.complete_within)
        assert first["status"] == "failed", first

    async def test_a_controller_that_dies_fails_its_goal(self, robot: Robot) -> None:
        id_ = await self.begun(robot, await self.far())
        self.jointed.kill()
        final = await robot.client.final(id_, self.complete_within)
        assert final["status"] == "failed", final
        self.jointed.start()


@pytest.mark.anyio
async def test_two_arms_are_parts_of_one_robot_with_their_own_joints() -> None:
    domain = fresh_domain()
    device = Jointed(domain, str(interfaces.built()), "two")
    device.start()
    try:
        async with robot_of(domain) as robot:
            names = {f"action/{side}_controller/move_joints" for side in ("left", "right")}
            await robot.until(lambda: names <= robot.resources.keys())
            state = "sensor/left_controller/joint_states"
            await robot.until(lambda: robot.resources[state].profiles == ("arm/1.0",))
            async with robot.backend.watch(state, 5.0):
                for _ in range(_SAMPLES):  # some of the topic's have the finger alone
                    value = await robot.read(state)
                    assert tuple(value.name) == LEFT
                await robot.until(lambda: len(robot.of(state)) > 1)
            assert {*map(tuple, (one.name for one in robot.of(state)))} == {LEFT}
            moved = await robot.execute(
                "action/left_controller/move_joints", {"positions": {"left_elbow": 0.2}}
            )
            assert abs(moved.positions["left_elbow"] - 0.2) < 0.05
            truth = device.tell("truth")["joints"]
            assert abs(truth["left_elbow"] - 0.2) < 0.05
            assert abs(truth["right_elbow"]) < 0.01
            assert MOVE not in robot.resources
    finally:
        device.stop()


@pytest.mark.anyio
async def test_a_controller_that_does_not_tell_its_joints_moves_those_of_the_driver_that_does() -> (
    None
):
    domain = fresh_domain()
    device = Jointed(domain, str(interfaces.built()), "untold")
    device.start()
    try:
        async with robot_of(domain) as robot:
            await robot.until(lambda: robot.resources.keys() >= {MOVE, "sensor/joint_states"})
            assert robot.resources[MOVE].meta["joints"] == []
            for there in (0.05, 0.1, 0.15, 0.2):  # samples with the finger alone come in between
                moved = await robot.execute(MOVE, {"positions": {"elbow": there}})
                assert moved.positions.keys() == {"shoulder", "elbow"}
            assert abs(device.tell("truth")["joints"]["elbow"] - 0.2) < 0.05
    finally:
        device.stop()
