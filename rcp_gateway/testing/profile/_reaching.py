"""`arm` and `gripper`: joints and fingers go where they are sent, in radians and metres."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

from rcp_gateway.testing._suite import eventually
from rcp_gateway.testing.backend._base import Robot
from rcp_gateway.testing.profile._rig import ProfileRig, needs

__all__ = ["ReachingTests"]

_JOINT = 0.05  # rad or m, tolerance of a joint
_FINGER = 0.005  # m
_STEP = 1.0  # s between two waypoints


class ReachingTests(ProfileRig):
    """Motions of arms and grippers."""

    async def _first_joint(self) -> tuple[str, Mapping[str, float]]:
        await self.make_ready()
        joints = await self.joints()
        return next(iter(joints)), joints

    async def _are_at(self, goal: Mapping[str, float]) -> None:
        joints = await self.joints()
        off = {name: joints[name] for name in goal if abs(joints[name] - goal[name]) > _JOINT}
        assert not off, f"joints at {off}, not at {dict(goal)}"

    @needs("action/move_joints")
    async def test_joints_go_where_they_are_sent_and_others_stay(self, robot: Robot) -> None:
        first, before = await self._first_joint()
        goal = {first: before[first] + self.reach}
        result, feedback = await self.run("action/move_joints", {"positions": goal})
        await self._are_at({**before, **goal})
        assert abs(result["positions"][first] - goal[first]) <= _JOINT
        left = [one["left"] for one in feedback]
        assert all(b - a <= _JOINT for a, b in itertools.pairwise(left)), left
        assert not left or left[0] <= self.reach + _JOINT, f"{left[0]} of {self.reach} is left"

    @needs("sensor/joint_states", "action/move_joints")
    async def test_joint_states_are_told_as_they_are(self, robot: Robot) -> None:
        first, before = await self._first_joint()
        await self.run("action/move_joints", {"positions": {first: before[first] + self.reach}})
        reported: dict[str, float] = {}  # of several samples: each may have some of the joints
        actual: Mapping[str, float] = before

        async def is_true() -> bool:
            nonlocal actual
            states, actual = await self.fresh("sensor/joint_states"), await self.joints()
            reported.update(zip(states["name"], states["position"], strict=True))
            return all(
                name in reported and abs(reported[name] - position) <= _JOINT
                for name, position in actual.items()
            )

        try:
            await eventually(is_true, "sensor/joint_states", self.cancel_within)
        except AssertionError as error:
            missing = ", ".join(actual.keys() - reported.keys())
            what = f"has no {missing}" if missing else f"is {reported}, not {dict(actual)}"
            raise AssertionError(f"sensor/joint_states {what}") from error

    @needs("action/move_joints")
    async def test_a_joint_that_there_is_not_is_refused(self, robot: Robot) -> None:
        first, before = await self._first_joint()
        goal = {first: before[first] + self.reach, "no_such_joint": 0.0}
        reply = await self.ask("execute", "action/move_joints", body={"positions": goal})
        assert reply["status"] == "rejected", reply
        await self._are_at(before)

    @needs("action/follow_trajectory")
    async def test_a_trajectory_passes_its_waypoints_in_order(self, robot: Robot) -> None:
        first, before = await self._first_joint()
        there = before[first] + self.reach
        points = [
            {"time": _STEP, "positions": {first: there}},
            {"time": 2 * _STEP, "positions": {first: before[first]}},
        ]
        path = self.running.path(self.full("action/follow_trajectory"))
        client = self.running.client
        id_ = await client.send(type="execute", path=path, body={"points": points})
        highest = math.inf

        async def passed() -> bool:
            nonlocal highest
            highest = min(highest, abs((await self.joints())[first] - there))
            return highest <= _JOINT

        await eventually(passed, "it passes the first waypoint", self.complete_within)
        final = await client.final(id_, self.complete_within)
        assert final["status"] == "completed", final
        await self._are_at(before)

    @needs("action/move_tool")
    async def test_the_tool_goes_where_it_is_sent(self, robot: Robot) -> None:
        await self.make_ready()
        x, y, z = await self.tool()
        goal = (x, y, z - self.near / 2)
        position = dict(zip("xyz", goal, strict=True))
        result, _ = await self.run("action/move_tool", {"position": position})
        off = math.dist(await self.tool(), goal)
        assert off <= self.near / 4, f"the tool is {off:g} m off, but reports {result['error']:g}"

    @needs("sensor/tool_pose")
    async def test_the_tools_pose_is_told_as_it_is(self, robot: Robot) -> None:
        await self.make_ready()
        reported = (await self.fresh("sensor/tool_pose"))["position"]
        actual = await self.tool()
        off = math.dist((reported["x"], reported["y"], reported["z"]), actual)
        assert off <= _JOINT, f"sensor/tool_pose is {reported}, not {actual}"

    @needs("action/move_gripper", "sensor/gripper")
    async def test_the_gripper_opens_and_closes(self, robot: Robot) -> None:
        await self.make_ready()
        wide = await self.opening()
        for width in (wide / 2, wide) if wide > _FINGER else (0.02, 0.0):
            await self.run("action/move_gripper", {"width": width})
            actual = await self.opening()
            assert abs(actual - width) <= _FINGER, f"the opening is {actual:g} m, not {width:g} m"
            reported = (await self.fresh("sensor/gripper"))["width"]
            off = abs(reported - actual)
            assert off <= _FINGER, f"sensor/gripper is {reported:g} m, not {actual:g} m"
