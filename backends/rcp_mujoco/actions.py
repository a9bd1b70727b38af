"""The actions of a simulated robot's parts, as coroutines that end with the motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import anyio
import numpy as np

from rcp_kernel.errors import DeviceRejected, InvalidValue
from rcp_kernel.spi import Progress
from rcp_kernel.types import PoseStamped, Quaternion
from rcp_mujoco.arm import Motion
from rcp_mujoco.device import Device
from rcp_mujoco.gripper import Grip
from rcp_mujoco.kinematics import ToolPose
from rcp_mujoco.paths import Path, Quintic, Spline, Waypoint
from rcp_mujoco.robot import Robot
from rcp_mujoco.wheels import Trip, make_trip
from rcp_profiles import messages as p

__all__ = ["Actions"]

_FEEDBACK = 0.1  # s of simulation time between feedback messages
_REST = 3.0  # s for a cancelled motion to come to rest


class _Task(Protocol):
    """A motion carried out by a controller."""

    failure: str | None

    @property
    def over(self) -> bool:
        """Whether it has ended, successfully or not."""
        ...


_Some = TypeVar("_Some", bound=_Task)


class Actions:
    """Drives, arm motions and grips."""

    def __init__(self, device: Device) -> None:
        self._device = device

    # Wheels

    async def move_to(self, goal: p.MoveTo, progress: Progress) -> p.MoveResult:
        """Drive to a pose in `map` or, relative to the robot, in `base_link`."""
        wheels = self._device.robot.wheels
        assert wheels is not None
        relative = goal.frame == wheels.config.base
        trip = await self._device.do(lambda _: self._trip(goal)) if relative else self._trip(goal)
        x, y = trip.x, trip.y
        length = math.dist(wheels.pose[:2], (x, y))

        def begin(_: Robot) -> Trip:
            wheels.go(trip)
            return trip

        def feedback(trip: Trip) -> None:
            pace = wheels.pace(trip)
            left = trip.left if math.isfinite(trip.left) else length
            feedback = p.MoveFeedback(left, left / pace if pace else None)
            progress(feedback, fraction=max(0.0, min(1.0, 1 - left / length)) if length else 1.0)

        await self._carry_out(begin, progress, feedback, wheels.abandon)
        return await self._device.do(lambda robot: self._arrived(robot, trip))

    def _trip(self, goal: p.MoveTo) -> Trip:
        """Return the trip to a goal from where the robot is.

        :raises InvalidValue: it is not a place, or its frame is unknown.
        """
        wheels = self._device.robot.wheels
        assert wheels is not None
        x, y, yaw = goal.position.x, goal.position.y, goal.yaw
        if not (math.isfinite(x) and math.isfinite(y)):
            raise InvalidValue("the goal is not a place", details={"pointer": "/position"})
        if goal.frame == wheels.config.base:
            x, y, yaw = _from_base(wheels.pose, x, y, yaw)
        elif goal.frame != "map":
            raise _unknown_frame(goal.frame, "map", wheels.config.base)
        return make_trip(x, y, yaw, goal.tolerance, goal.speed)

    def _arrived(self, robot: Robot, trip: Trip) -> p.MoveResult:
        pose = next(r for r in self._device.publisher.readings if r.name == "sensor/pose")
        here: PoseStamped = pose.read(self._device.publisher.stamp)
        off = math.dist((here.position.x, here.position.y), (trip.x, trip.y))
        return p.MoveResult(here, off)

    # Arm

    async def move_joints(self, goal: Any, progress: Progress) -> p.JointsMoved:
        """Move along a straight line in joint space."""
        arm = self._device.robot.arm
        assert arm is not None
        targets = goal.positions.given()
        if not targets:
            raise _no_joint()

        def plan(_: Robot) -> Motion:
            here = arm.positions.copy()
            there = _filled(arm.names, here, targets)
            speed, acceleration = arm.config.speed * goal.speed, arm.config.acceleration
            return self._follow(Quintic(here, there, speed=speed, acceleration=acceleration))

        def feedback(motion: Motion) -> None:
            progress(p.MoveJointsFeedback(self._positions(), motion.left), fraction=_part(motion))

        return await self._move(plan, progress, feedback)

    async def follow_trajectory(self, goal: Any, progress: Progress) -> p.JointsMoved:
        """Move through waypoints."""
        arm = self._device.robot.arm
        assert arm is not None

        def plan(_: Robot) -> Motion:
            here = arm.positions.copy()
            points, places = list[Waypoint](), here
            for point in goal.points:
                places = _filled(arm.names, places, point.positions.given())
                speeds = point.velocities
                velocities = _filled(arm.names, np.zeros_like(here), speeds) if speeds else None
                if speeds and (unknown := set(speeds) - set(arm.names)):
                    raise InvalidValue(
                        f"the arm has no joint {', '.join(sorted(unknown))}",
                        details={"pointer": "/points"},
                    )
                points.append(Waypoint(point.time, places, velocities))
            return self._follow(Spline(here, points, speed=arm.config.speed, names=arm.names))

        def feedback(motion: Motion) -> None:
            feedback = p.TrajectoryFeedback(motion.seconds, self._positions(), motion.error)
            progress(feedback, fraction=_part(motion))

        return await self._move(plan, progress, feedback)

    async def move_tool(self, goal: p.MoveTool, progress: Progress) -> p.MoveResult:
        """Move the tool to a pose, along a straight line in joint space."""
        device = self._device
        arm, kinematics = device.robot.arm, device.robot.kinematics
        assert arm is not None
        assert kinematics is not None
        relative = goal.frame == "map"
        found = (
            await device.do(lambda _: self._tool_goal(goal)) if relative else self._tool_goal(goal)
        )
        target, turn = found
        qpos = await device.do(lambda robot: robot.simulation.data.qpos.copy())
        joints = await anyio.to_thread.run_sync(kinematics.solve, qpos, target, turn)

        def plan(_: Robot) -> Motion:
            here = arm.positions.copy()
            distance = float(np.linalg.norm(target - kinematics.tool().position))
            path = Quintic(
                here,
                joints,
                speed=arm.config.speed,
                acceleration=arm.config.acceleration,
                least=0.0 if goal.speed is None else 1.875 * distance / goal.speed,
            )
            return self._follow(path)

        def feedback(motion: Motion) -> None:
            left = float(np.linalg.norm(target - kinematics.tool().position))
            progress(p.MoveFeedback(left, motion.time_left), fraction=_part(motion))

        await self._move(plan, progress, feedback)
        here = await device.do(lambda robot: robot.tool_pose(device.publisher.stamp, goal.frame))
        tool = await device.do(lambda _: kinematics.tool().position)
        return p.MoveResult(here, float(np.linalg.norm(target - tool)))

    def _tool_goal(self, goal: p.MoveTool) -> tuple[Any, Any | None]:
        """Return position and quaternion of a goal in the frame of the base.

        :raises RcpError: it is not a place, its frame is unknown, or it is out of reach.
        """
        arm, kinematics = self._device.robot.arm, self._device.robot.kinematics
        assert arm is not None
        assert kinematics is not None
        target = np.array([goal.position.x, goal.position.y, goal.position.z])
        if not np.isfinite(target).all():
            raise InvalidValue("the goal is not a place", details={"pointer": "/position"})
        turn = None if goal.orientation is None else _wxyz(goal.orientation)
        if goal.frame == "map":
            given_turn = np.array([1.0, 0, 0, 0]) if turn is None else turn
            local = kinematics.local(ToolPose(target, given_turn))
            target, turn = local.position, None if turn is None else local.quaternion
        elif goal.frame != arm.config.base:
            raise _unknown_frame(goal.frame, "map", arm.config.base)
        kinematics.check_reach(target)
        return target, turn

    def foresee(self, name: str, goal: Any) -> None:
        """Refuse a goal in an obstacle, out of the arm's reach, or without a joint.

        It looks at the simulation while that is stepped: what it checks stands still.
        """
        wheels, arm = self._device.robot.wheels, self._device.robot.arm
        if name == "action/move_to" and wheels is not None:
            wheels.check_goal(self._trip(goal))
        elif name == "action/move_tool" and arm is not None:
            self._tool_goal(goal)
        elif name == "action/move_joints" and not goal.positions.given():
            raise _no_joint()

    def _follow(self, path: Path) -> Motion:
        arm = self._device.robot.arm
        assert arm is not None
        motion = Motion(path)
        arm.follow(motion)
        return motion

    async def _move(
        self,
        plan: Callable[[Robot], Motion],
        progress: Progress,
        feedback: Callable[[Motion], None],
    ) -> p.JointsMoved:
        arm = self._device.robot.arm
        assert arm is not None
        motion = await self._carry_out(plan, progress, feedback, arm.abandon)
        positions = await self._device.do(lambda _: self._positions())
        return p.JointsMoved(positions, motion.path.duration + motion.settling)

    def _positions(self) -> dict[str, float]:
        arm = self._device.robot.arm
        assert arm is not None
        return dict(zip(arm.names, arm.positions.tolist(), strict=True))

    # Gripper

    async def move_gripper(self, goal: p.MoveGripper, progress: Progress) -> p.GripperState:
        """Move the fingers."""
        device = self._device
        gripper = device.robot.gripper
        assert gripper is not None
        grip = Grip(goal.width, goal.force)
        start = gripper.width

        def begin(_: Robot) -> Grip:
            gripper.move(grip)
            return grip

        def feedback(_: Grip) -> None:
            travel = abs(goal.width - start) or 1.0
            part = 1 - abs(goal.width - gripper.width) / travel
            state = device.robot.grip_state(device.publisher.stamp)
            progress(state, fraction=max(0.0, min(1.0, part)))

        await self._carry_out(begin, progress, feedback, gripper.abandon)
        return await device.do(lambda robot: robot.grip_state(device.publisher.stamp))

    # All of them

    async def _carry_out(
        self,
        begin: Callable[[Robot], _Some],
        progress: Progress,
        feedback: Callable[[_Some], None],
        abandon: Callable[[_Some], None],
    ) -> _Some:
        """Start a task and wait for its end; a cancellation brings the robot to rest first.

        :raises DeviceRejected: it failed.
        """
        device, simulation = self._device, self._device.robot.simulation
        begun: list[_Some] = []
        try:
            await device.do(lambda robot: begun.append(begin(robot)), moves=True)
            progress(fraction=0.0)  # it has begun, whatever its outcome
            task = begun[0]
            while not task.over and simulation.fault is None:
                feedback(task)
                due = simulation.elapsed + _FEEDBACK
                await device.waiting.until(
                    lambda due=due: (
                        task.over or simulation.fault is not None or simulation.elapsed >= due
                    )
                )
        except anyio.get_cancelled_exc_class():
            with anyio.move_on_after(_REST, shield=True):
                # It may have begun before its result arrives here: jobs run in order.
                await device.do(lambda _: [abandon(task) for task in begun])
                number = device.snapshot.number  # an earlier one may be of before it began
                await device.waiting.until(lambda: device.snapshot.number > number)
                await device.waiting.until(
                    lambda: (
                        device.snapshot.at_rest
                        or device.stepper.pace.paused
                        or simulation.fault is not None
                    )
                )
            raise
        if simulation.fault is not None:
            raise DeviceRejected(
                f"the simulation has stopped: {simulation.fault}",
                remedy="Execute service/reset to start it again.",
            )
        if task.failure is not None:
            raise DeviceRejected(task.failure)
        feedback(task)
        return task


def _no_joint() -> InvalidValue:
    return InvalidValue("no joint to move", details={"pointer": "/positions"})


def _part(motion: Motion) -> float:
    return min(1.0, motion.seconds / motion.path.duration)


def _filled(names: list[str], here: Any, targets: dict[str, float]) -> Any:
    places = here.copy()
    for index, name in enumerate(names):
        if name in targets:
            places[index] = targets[name]
    return places


def _wxyz(turn: Quaternion) -> Any:
    rotation = np.array([turn.w, turn.x, turn.y, turn.z])
    length = float(np.linalg.norm(rotation))
    if not math.isfinite(length) or length < 0.1:
        raise InvalidValue("the orientation is not a rotation", details={"pointer": "/orientation"})
    return rotation / length


def _from_base(
    pose: tuple[float, float, float], x: float, y: float, yaw: float | None
) -> tuple[float, float, float | None]:
    here_x, here_y, heading = pose
    cosine, sine = math.cos(heading), math.sin(heading)
    turned = None if yaw is None else yaw + heading
    return here_x + cosine * x - sine * y, here_y + sine * x + cosine * y, turned


def _unknown_frame(frame: str, *known: str) -> InvalidValue:
    return InvalidValue(
        f"there is no frame '{frame}'; there are {', '.join(known)}",
        details={"pointer": "/frame"},
    )
