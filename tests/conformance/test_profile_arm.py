"""The profile suite on an arm with a gripper, and on arms that are wrong."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import pytest

from conformance.test_profile_flaws import prove
from hurry import HURRIED, Hurried
from rcp_gateway.testing import ProfileSuite
from rcp_kernel.spi import BackendKind, BaseBackend, Host, MotionState, Progress
from rcp_kernel.types import Point, PoseStamped
from rcp_profiles import claim, offer
from rcp_profiles import messages as m

TICK = 0.005  # s
REACH = (-2.0, 2.0)  # rad
JOINTS = ("shoulder", "elbow")
LIMITS = dict.fromkeys((f"positions.{name}" for name in JOINTS), REACH)
WAYPOINTS = {f"points.{place}": bound for place, bound in LIMITS.items()}


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    """Sit out nothing: the device is on the test's loop."""
    return HURRIED


class Arm(BaseBackend):
    """Two joints of one metre each, and fingers; all of them move at one speed."""

    scale = 1.0
    """Of a joint's position, from what is commanded to what the device does."""

    def __init__(self) -> None:
        self.joints: dict[str, float] = dict.fromkeys(JOINTS, 0.3)
        self.width = 0.08
        self.moves = False

    def positions(self) -> dict[str, float]:
        return {name: position / self.scale for name, position in self.joints.items()}

    def tool(self) -> tuple[float, float, float]:
        first, second = self.joints["shoulder"], sum(self.joints.values())
        return math.cos(first) + math.cos(second), 0.0, math.sin(first) + math.sin(second)

    async def read(self, name: str) -> Any:
        if name == "sensor/gripper":
            return m.GripperState(self.width, holding=False)
        if name == "sensor/tool_pose":
            return PoseStamped(Point(*self.tool()), frame_id="base_link")
        positions = self.positions()
        return m.JointStates([*positions], [*positions.values()], [0.0] * len(positions))

    async def toward(self, goal: Mapping[str, float], seconds: float) -> AsyncGenerator[float]:
        """Move in a straight line; yield the part that is left."""
        start, steps = dict(self.joints), max(1, round(seconds / TICK))
        self.moves = True
        try:
            for step in range(1, steps + 1):
                part = step / steps
                for name, end in goal.items():
                    self.joints[name] = start[name] + (end * self.scale - start[name]) * part
                yield 1 - part
                await asyncio.sleep(TICK)
        finally:
            self.moves = False

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        match name:
            case "action/move_gripper":
                self.width = value.width
                return m.GripperState(self.width, holding=False)
            case "action/move_joints":
                goal = value.positions.given()
                far = max(abs(goal[n] * self.scale - self.joints[n]) for n in goal)
                async for left in self.toward(goal, 0.3):
                    progress(m.MoveJointsFeedback(self.positions(), far * left))
            case _:
                reached = 0.0
                for point in value.points:
                    goal = point.positions.given()
                    async for _ in self.toward(goal, point.time - reached):
                        progress(m.TrajectoryFeedback(reached, self.positions(), 0.0))
                    reached = point.time
        return m.JointsMoved(self.positions(), 0.3)

    async def halt(self) -> None:
        self.moves = False

    def motion(self, robot: str | None) -> MotionState:
        return MotionState(at_rest=not self.moves)


class Degrees(Arm):
    scale = math.pi / 180


class Blind(Arm):
    async def read(self, name: str) -> Any:
        value = await super().read(name)
        if name == "sensor/joint_states":
            return msgspec.structs.replace(value, position=[0.3, 0.3])
        return value


class InParts(Arm):
    """Tells its joints one at a time, as robots with several drivers do."""

    told = itertools.cycle(("claw", *JOINTS))

    async def read(self, name: str) -> Any:
        value = await super().read(name)
        if name != "sensor/joint_states":
            return value
        positions = self.positions() | {"claw": 0.01}
        one = next(self.told)
        return msgspec.structs.replace(value, name=[one], position=[positions[one]], velocity=[])


class Mute(InParts):
    """Never tells one of its joints."""

    told = itertools.cycle(("claw", "elbow"))


class Impatient(Arm):
    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        if name == "action/follow_trajectory":
            value = msgspec.structs.replace(value, points=value.points[-1:])
        return await super().execute(name, value, progress)


class Inches(Arm):
    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        if name == "action/move_gripper":
            value = msgspec.structs.replace(value, width=value.width * 0.0254)
        return await super().execute(name, value, progress)


class Crooked(Arm):
    async def read(self, name: str) -> Any:
        if name == "sensor/tool_pose":
            x, y, z = self.tool()
            return PoseStamped(Point(z, y, x), frame_id="base_link")
        return await super().read(name)


def kind_of(arm: type[Arm], place: str | None = None) -> BackendKind:
    @asynccontextmanager
    async def opened(_: msgspec.Struct, host: Host) -> AsyncGenerator[Arm]:
        host.declare(
            *claim(
                ["arm", "gripper"],
                "sensor/joint_states",
                offer("action/move_joints", LIMITS),
                offer("action/follow_trajectory", WAYPOINTS),
                "sensor/tool_pose",
                "sensor/gripper",
                offer("action/move_gripper", {"width": (0, 0.08)}),
                place=place,
            )
        )
        yield arm()

    return BackendKind("arm", msgspec.Struct, opened)


class TestArm(Hurried, ProfileSuite):
    """An arm without a flaw."""

    kind = kind_of(Arm)
    profiles = ("arm", "gripper")

    async def joints(self) -> Mapping[str, float]:
        return dict(self.backend.joints)

    async def opening(self) -> float:
        return self.backend.width

    async def tool(self) -> tuple[float, float, float]:
        return self.backend.tool()


@pytest.mark.parametrize(
    ("flaw", "test", "says"),
    [
        (Degrees, "test_joints_go_where_they_are_sent_and_others_stay", "joints at"),
        (Blind, "test_joint_states_are_told_as_they_are", "sensor/joint_states is"),
        (Mute, "test_joint_states_are_told_as_they_are", "has no shoulder"),
        (Impatient, "test_a_trajectory_passes_its_waypoints_in_order", "the first waypoint"),
        (Inches, "test_the_gripper_opens_and_closes", "the opening is"),
        (Crooked, "test_the_tools_pose_is_told_as_it_is", "sensor/tool_pose is"),
    ],
    ids=lambda item: getattr(item, "__name__", None),
)
async def test_a_flaw_is_found(flaw: type[Arm], test: str, says: str) -> None:
    class Suite(TestArm):
        kind = kind_of(flaw)
        complete_within = 3.0 if flaw is Impatient else TestArm.complete_within
        cancel_within = 0.5

    with pytest.raises(AssertionError, match=says):
        await prove(Suite(), test)


async def test_joints_may_be_told_in_several_samples() -> None:
    class Suite(TestArm):
        kind = kind_of(InParts)

    await prove(Suite(), "test_joint_states_are_told_as_they_are")


class Left(Arm):
    """One of several parts of a robot."""

    async def read(self, name: str) -> Any:
        return await super().read(name.replace("/left/", "/"))

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        return await super().execute(name.replace("/left/", "/"), value, progress)


@pytest.mark.parametrize(
    "test",
    [
        "test_it_claims_what_its_author_says",
        "test_what_it_does_not_claim_is_refused",
        "test_joints_go_where_they_are_sent_and_others_stay",
        "test_the_gripper_opens_and_closes",
    ],
)
async def test_a_part_is_proved_at_its_place(test: str) -> None:
    class Suite(TestArm):
        kind = kind_of(Left, "left")
        place = "left"

    await prove(Suite(), test)
