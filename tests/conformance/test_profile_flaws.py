"""The profile suite finds a robot that is right in its types and wrong in what it does."""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from msgspec.structs import replace

from conformance.test_backend_sim import TestSimProfiles as SimProfiles
from hurry import HURRIED
from rcp_gateway.testing import Body, ProfileSuite, Robot
from rcp_kernel.spi import BackendKind, Host, Progress
from rcp_kernel.types import Twist
from rcp_sim import SimBackend, SimConfig, open_sim


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, Any]]:
    """Sit out nothing: the device is on the test's loop."""
    return HURRIED


class Flawed(SimBackend):
    """The simulated rover, in which each flaw below changes one thing."""

    def heard(self, value: Twist) -> Twist:
        """Return the velocity that it takes for the commanded one."""
        return value

    async def write(self, name: str, value: Any) -> Any:
        """Write what was heard."""
        return await super().write(name, self.heard(value) if name.endswith("cmd_vel") else value)


def turning(value: Twist, rate: float) -> Twist:
    return replace(value, angular=replace(value.angular, z=rate))


class Degrees(Flawed):
    def heard(self, value: Twist) -> Twist:
        return turning(value, math.radians(value.angular.z))


class Mirrored(Flawed):
    def heard(self, value: Twist) -> Twist:
        return turning(value, -value.angular.z)


class Backwards(Flawed):
    def heard(self, value: Twist) -> Twist:
        return replace(value, linear=replace(value.linear, x=-value.linear.x))


class Centimetres(Flawed):
    def heard(self, value: Twist) -> Twist:
        return replace(value, linear=replace(value.linear, x=value.linear.x / 4))


class NeverStops(Flawed):
    async def write(self, name: str, value: Any) -> Any:
        if name.endswith("cmd_vel") and value == type(value)():
            return self.device.publisher.make(name, 0)
        return await super().write(name, value)


class HoldsNothing(Flawed):
    async def hold(self, robot: str | None) -> None:
        """Say so, and go on."""

    def motion(self, robot: str | None) -> Any:
        return None


class LiesOfSpeed(Flawed):
    async def read(self, name: str) -> Any:
        value = await super().read(name)
        if name == "sensor/velocity":
            return replace(value, angular=replace(value.angular, z=math.degrees(value.angular.z)))
        return value


class LiesOfPlace(Flawed):
    async def read(self, name: str) -> Any:
        value = await super().read(name)
        if name == "sensor/pose":
            at = value.position
            return replace(value, position=replace(at, x=at.y + 1.0, y=at.x))
        return value


class LiesOfCharge(Flawed):
    async def read(self, name: str) -> Any:
        value = await super().read(name)
        return replace(value, percentage=0.2) if name == "sensor/battery" else value


class MirroredScan(Flawed):
    async def read(self, name: str) -> Any:
        value = await super().read(name)
        if name == "sensor/scan":
            half = len(value.ranges) // 2
            return replace(value, ranges=value.ranges[half:] + value.ranges[:half])
        return value


class FalseRight(Flawed):
    """Counts from 0 to a whole turn, and tells of the left again on the right."""

    async def read(self, name: str) -> Any:
        value = await super().read(name)
        if name == "sensor/scan":
            left = value.ranges[len(value.ranges) // 2 :]
            return replace(value, angle_min=value.angle_min + math.pi, ranges=left + left[::-1])
        return value


class NowhereScan(Flawed):
    async def read(self, name: str) -> Any:
        value = await super().read(name)
        return replace(value, ranges=value.ranges[:1]) if name == "sensor/scan" else value


class Goal(Flawed):
    """Flaws in what becomes of a goal."""

    def meant(self, goal: Any) -> Any:
        return goal

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        value = self.meant(value) if name == "action/move_to" else value
        return await super().execute(name, value, self.reported(progress))

    def reported(self, progress: Progress) -> Progress:
        return progress


class Swapped(Goal):
    def meant(self, goal: Any) -> Any:
        at = goal.position
        return replace(goal, position=replace(at, x=at.y, y=at.x))


class HeadingInDegrees(Goal):
    def meant(self, goal: Any) -> Any:
        return replace(goal, yaw=None if goal.yaw is None else math.radians(goal.yaw))


class AnyFrame(Goal):
    def meant(self, goal: Any) -> Any:
        return replace(goal, frame="map")


class Hasty(Goal):
    async def write(self, name: str, value: Any) -> Any:
        if name == "param/speed_limit":
            await super().write(name, 2.5)
            return value
        return await super().write(name, value)

    async def read(self, name: str) -> Any:
        return 0.4 if name == "param/speed_limit" else await super().read(name)


class Sluggish(Goal):
    """Ignores its limit, and reaches hardly more than a moderate speed."""

    limit = 0.45

    async def write(self, name: str, value: Any) -> Any:
        if name == "param/speed_limit":
            self.limit = value
            return value
        return await super().write(name, value)

    async def read(self, name: str) -> Any:
        return self.limit if name == "param/speed_limit" else await super().read(name)

    def meant(self, goal: Any) -> Any:
        return replace(goal, speed=0.45)


class Rising(Goal):
    def reported(self, progress: Progress) -> Progress:
        def upside_down(feedback: Any = None, *, fraction: float | None = None) -> None:
            if feedback is not None and hasattr(feedback, "distance_remaining"):
                left = max(0.0, 1.5 - feedback.distance_remaining)
                feedback = replace(feedback, distance_remaining=left)
            progress(feedback, fraction=fraction)

        return upside_down


class Millimetres(Goal):
    def reported(self, progress: Progress) -> Progress:
        def larger(feedback: Any = None, *, fraction: float | None = None) -> None:
            if feedback is not None and hasattr(feedback, "distance_remaining"):
                far = feedback.distance_remaining * 1000
                feedback = replace(feedback, distance_remaining=far)
            progress(feedback, fraction=fraction)

        return larger


def suite_of(flaw: type[Flawed]) -> ProfileSuite:
    """Return the suite of the simulated rover, with a flaw."""

    @asynccontextmanager
    async def opened(config: SimConfig, host: Host) -> AsyncGenerator[SimBackend]:
        async with open_sim(config, host) as backend:
            yield flaw(backend.device)

    class Suite(SimProfiles):
        kind = BackendKind("sim", SimConfig, opened)
        complete_within = 4.0 if flaw is Degrees else SimProfiles.complete_within
        cancel_within = 1.5

    return Suite()


async def prove(suite: ProfileSuite, test: str) -> None:
    """Run one test of the suite."""
    found: Callable[..., Any] = getattr(suite, test)
    async with suite.opened() as robot:
        assert isinstance(robot, Robot)
        await found(robot)


FLAWS = [
    (Degrees, "test_a_positive_yaw_rate_turns_it_left", r"it turned .* commanded 0\.5 rad/s"),
    (Mirrored, "test_a_positive_yaw_rate_turns_it_left", "rad to the right"),
    (Backwards, "test_a_forward_velocity_moves_it_ahead", "m back"),
    (Centimetres, "test_a_forward_velocity_moves_it_ahead", r"its speed, in m/s, is 0\.1"),
    (NeverStops, "test_it_stops_when_the_command_lapses", "at rest after the command's time"),
    (HoldsNothing, "test_a_hold_stops_it", "the hold is completed, but the robot moves"),
    (LiesOfSpeed, "test_its_velocity_is_told_as_it_is", "sensor/velocity is"),
    (LiesOfPlace, "test_its_pose_is_told_as_it_is", "sensor/pose is"),
    (LiesOfCharge, "test_the_battery_tells_what_is_left", r"reported as 0\.2"),
    (FalseRight, "test_the_scan_tells_how_far_things_are_on_each_side", " rad, not "),
    (NowhereScan, "test_the_scan_tells_how_far_things_are_on_each_side", "it has no beam"),
    (MirroredScan, "test_the_scan_tells_how_far_things_are_on_each_side", " rad, not "),
    (Swapped, "test_it_goes_one_metre_along_x", r"sent \(1, 0\) m, it went \(0\.00, 0\.9"),
    (HeadingInDegrees, "test_it_turns_to_the_heading_of_its_goal", "heads 0, not 1"),
    (AnyFrame, "test_a_frame_that_it_does_not_know_is_refused", "a frame that there is not"),
    (Hasty, "test_it_keeps_to_the_speed_limit", "limit 0.4 m/s, driven"),
    (Sluggish, "test_it_keeps_to_the_speed_limit", r"limit 0\.2\d* m/s, driven 0\.4"),
    (Rising, "test_its_feedback_tells_the_metres_and_seconds_left", "the distance grew|was left"),
    (Millimetres, "test_its_feedback_tells_the_metres_and_seconds_left", "1 m was left"),
]


@pytest.mark.parametrize(
    ("flaw", "test", "says"), FLAWS, ids=lambda item: getattr(item, "__name__", None)
)
async def test_a_flaw_is_found(flaw: type[Flawed], test: str, says: str) -> None:
    with pytest.raises(AssertionError, match=says):
        await prove(suite_of(flaw), test)


async def test_a_probe_that_is_missing_is_told() -> None:
    class Bare(ProfileSuite):
        kind = SimProfiles.kind
        config = SimProfiles.config
        profiles = ("mobile",)

    suite = Bare()
    with pytest.raises(
        AssertionError, match=r"body\(\) is not given, which actuator/cmd_vel needs"
    ):
        await prove(suite, "test_each_claim_can_be_proved")
    with pytest.raises(AssertionError, match=r"it claims .*battery.*, and is said to"):
        await prove(suite, "test_it_claims_what_its_author_says")


def test_a_place_is_seen_from_another_one() -> None:
    start = Body(x=1.0, y=1.0, yaw=math.pi / 2)
    ahead, left = Body(x=1.0, y=3.0, yaw=0.0).ahead_of(start)
    assert (ahead, left) == pytest.approx((2.0, 0.0))
    assert Body(x=0.0, y=0.0, yaw=-math.pi).turned_from(start) == pytest.approx(math.pi / 2)
