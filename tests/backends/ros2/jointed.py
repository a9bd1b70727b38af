"""An arm with a trajectory controller that is as strict as that of ros2_control; its truth is in its process.

Run as `python jointed.py ROOT`; takes orders as `robot_nodes.py` does. ROOT has the built interfaces.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

import interfaces
import rclpy
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

interfaces.use(Path(sys.argv[1]))
from control_msgs.action import FollowJointTrajectory  # noqa: E402 - built just now

PERIOD = 0.01  # s
STRONG = 6.0  # rad/s² that the motors can do
JOINTS = ("shoulder", "elbow")
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
URDF = """<robot name="reacher">
<joint name="shoulder" type="revolute"><limit lower="-2.0" upper="2.0" effort="9" velocity="1.5"/></joint>
<joint name="elbow" type="revolute"><limit lower="-2.5" upper="2.5" effort="9" velocity="1.5"/></joint>
<joint name="finger" type="prismatic"><limit lower="0" upper="0.05" effort="9" velocity="0.1"/></joint>
</robot>"""
FEEDBACK, RESULT = FollowJointTrajectory.Feedback, FollowJointTrajectory.Result


def moment(duration: Any) -> float:
    return duration.sec + duration.nanosec / 1e9


class Controller(Node):
    """A joint_trajectory_controller."""

    def __init__(self, name: str, joints: tuple[str, ...]) -> None:
        super().__init__(name)
        self.names = joints
        if "untold" not in sys.argv:
            self.declare_parameter("joints", list(joints))
        self.places = dict.fromkeys(joints, 0.0)
        self.speeds = dict.fromkeys(joints, 0.0)
        self.targets = dict(self.places)
        self.tolerance = 0.2  # rad that a joint may be behind
        self.stuck: str | None = None
        self.braking = STRONG
        self.current: Any = None
        self.goals = self.running = 0
        self.server = ActionServer(
            self,
            FollowJointTrajectory,
            f"{name}/follow_joint_trajectory",
            self.run,
            goal_callback=self.admit,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    def admit(self, goal: Any) -> GoalResponse:
        """Refuse what ros2_control refuses."""
        given, points = goal.trajectory.joint_names, goal.trajectory.points
        fits = sorted(given) == sorted(self.names) and len(points) > 0
        before = -1.0
        for point in points:
            at = moment(point.time_from_start)
            sizes = (len(point.positions), len(point.velocities), len(point.accelerations))
            fits = fits and at > before and sizes[0] == len(given)
            fits = fits and all(size in (0, len(given)) for size in sizes[1:]) and not point.effort
            before = at
        if fits and any(points[-1].velocities):
            fits = False
        return GoalResponse.ACCEPT if fits else GoalResponse.REJECT

    def run(self, goal: Any) -> Any:
        self.goals += 1
        self.running += 1
        self.current = goal
        try:
            return self.follow(goal)
        finally:
            if self.current is goal:
                self.targets = None  # brake, then hold
            self.running -= 1

    def follow(self, goal: Any) -> Any:
        trajectory = goal.request.trajectory
        start = dict(self.places)
        began, told = time.monotonic(), 0.0
        end = moment(trajectory.points[-1].time_from_start)
        while (now := time.monotonic() - began) < end:
            if self.current is not goal:
                goal.abort()
                return RESULT(error_string="Current goal cancelled due to new incoming action.")
            if goal.is_cancel_requested:
                goal.canceled()
                return RESULT()
            self.targets = wanted = self.at(trajectory, start, now)
            off = {name: wanted[name] - self.places[name] for name in self.names}
            if max(map(abs, off.values())) > self.tolerance:
                goal.abort()
                return RESULT(
                    error_code=RESULT.PATH_TOLERANCE_VIOLATED,
                    error_string="Aborted due to path tolerance violation",
                )
            if now - told >= 0.05:
                told = now
                feedback = FEEDBACK(joint_names=list(self.names))
                feedback.desired.positions = [wanted[name] for name in self.names]
                feedback.actual.positions = [self.places[name] for name in self.names]
                feedback.error.positions = [off[name] for name in self.names]
                goal.publish_feedback(feedback)
            time.sleep(PERIOD)
        self.targets = self.at(trajectory, start, end)
        goal.succeed()  # as without `constraints`: the time is over
        return RESULT()

    def at(self, trajectory: Any, start: dict[str, float], now: float) -> dict[str, float]:
        """Interpolate as ros2_control does: cubic between points with velocities, or linear."""
        names = trajectory.joint_names
        before, at, slopes = dict(start), 0.0, dict.fromkeys(names, 0.0)
        for point in trajectory.points:
            there = dict(zip(names, point.positions, strict=True))
            next_ = moment(point.time_from_start)
            curved = len(point.velocities) > 0 and slopes is not None
            ends = dict(zip(names, point.velocities, strict=False)) or None
            if now <= next_:
                span = max(next_ - at, 1e-9)
                part = (now - at) / span
                if not curved:
                    return {n: before[n] + (there[n] - before[n]) * part for n in names}
                return {
                    n: cubic(before[n], there[n], slopes[n] * span, ends[n] * span, part)
                    for n in names
                }
            before, at, slopes = there, next_, ends
        return before

    def turn(self) -> None:
        """Turn the motors towards their targets."""
        targets = self.targets
        for name in self.names:
            speed = self.speeds[name]
            if name == self.stuck:
                self.speeds[name] = 0.0
                continue
            if targets is None:
                wanted, most = 0.0, self.braking * PERIOD
            else:
                wanted, most = 20.0 * (targets[name] - self.places[name]), STRONG * 4 * PERIOD
            self.speeds[name] = speed + max(-most, min(most, wanted - speed))
            self.places[name] += self.speeds[name] * PERIOD


def cubic(a: float, b: float, u: float, v: float, t: float) -> float:
    return (
        (2 * t**3 - 3 * t**2 + 1) * a
        + (t**3 - 2 * t**2 + t) * u
        + (3 * t**2 - 2 * t**3) * b
        + (t**3 - t**2) * v
    )


class Cell(Node):
    """Publishes the joint states and the description of the robot."""

    def __init__(self, controllers: list[Controller]) -> None:
        super().__init__("cell")
        self.controllers = controllers
        self.told = True
        self.delay = 0.0
        """s for which joint states are kept before they are published."""
        self.kept: deque[tuple[float, JointState]] = deque()
        self.states = self.create_publisher(JointState, "joint_states", 10)
        self.fingers = self.create_publisher(JointState, "joint_states", 10)
        self.create_publisher(String, "robot_description", LATCHED).publish(String(data=URDF))
        self.create_timer(0.02, self.measure)
        self.create_timer(0.01, self.feel)
        threading.Thread(target=self.turn, daemon=True).start()

    def turn(self) -> None:
        due = time.monotonic()
        while True:
            while due <= time.monotonic():  # however late: what moves has its own time
                due += PERIOD
                for controller in self.controllers:
                    controller.turn()
            time.sleep(PERIOD)

    def measure(self) -> None:
        state = JointState()
        state.header.stamp = self.get_clock().now().to_msg()
        for one in self.controllers:
            state.name = [*state.name, *one.places]
            state.position = [*state.position, *one.places.values()]
            state.velocity = [*state.velocity, *(one.speeds.values() if self.told else ())]
        self.kept.append((time.monotonic(), state))
        while self.kept and self.kept[0][0] + self.delay <= time.monotonic():
            self.states.publish(self.kept.popleft()[1])

    def feel(self) -> None:
        """Publish as another driver does on the same topic, and more often: most samples have no arm."""
        state = JointState(name=["finger"], position=[0.01], velocity=[0.0])
        state.header.stamp = self.get_clock().now().to_msg()
        self.fingers.publish(state)


class Robot:
    """The arms, and what they can be told to do."""

    def __init__(self, controllers: dict[str, tuple[str, ...]]) -> None:
        self.controllers = [Controller(name, joints) for name, joints in controllers.items()]
        self.cell = Cell(self.controllers)
        executor = MultiThreadedExecutor(6)
        for node in (*self.controllers, self.cell):
            executor.add_node(node)
        threading.Thread(target=executor.spin, daemon=True).start()

    def truth(self) -> dict[str, Any]:
        """Tell how things are, past every interface of ROS."""
        return {
            "joints": {n: p for one in self.controllers for n, p in one.places.items()},
            "speed": max(abs(s) for one in self.controllers for s in one.speeds.values()),
            "goals": sum(one.goals for one in self.controllers),
            "running": sum(one.running for one in self.controllers),
        }

    def set(self, **values: Any) -> None:
        """Change the first controller: its `tolerance`, `braking` or `stuck` joint."""
        for name, value in values.items():
            setattr(self.controllers[0], name, value)

    def tell_late(self, *, delay: float) -> None:
        """Publish joint states some seconds late."""
        self.cell.delay = delay

    def tell_speeds(self, *, told: bool) -> None:
        """Publish velocities, or positions alone."""
        self.cell.told = told


def main() -> None:
    from robot_nodes import serve

    rclpy.init()
    one = {"arm_controller": JOINTS}
    two = {f"{side}_controller": tuple(f"{side}_{j}" for j in JOINTS) for side in ("left", "right")}
    serve(Robot(two if "two" in sys.argv else one))
    os._exit(0)  # whatever still spins


if __name__ == "__main__":
    main()
