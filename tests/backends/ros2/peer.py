"""A robot in a process of its own: every primitive of ROS 2 that the backend maps, and a few traps.

Run as `python peer.py [name [manner]]`; prints `ready` when everything is offered, answers each line with how
things are, and ends with its stdin, so that no peer outlives a test run that was killed.
"""

from __future__ import annotations

import gc
import json
import math
import os
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, LaserScan
from std_msgs.msg import Float64, String
from std_srvs.srv import Empty, SetBool, Trigger
from test_msgs.action import Fibonacci
from test_msgs.srv import BasicTypes

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
DESCRIPTION = """<robot name="peer"><link name="base"><visual><geometry>
<mesh filename="package://peer_description/base.stl"/>
</geometry></visual></link></robot>"""


class Peer(Node):
    """The robot."""

    def __init__(self, name: str, manner: str) -> None:
        super().__init__(name)
        self.manner = manner
        """Which goals it accepts, and when."""
        self.retired = False
        self.group = ReentrantCallbackGroup()
        self.on = False
        self.twist = Twist()
        self.running = 0
        self.began = 0
        self.result: list[int] = []
        self.sources()
        self.sinks()
        self.calls()
        self.settings()
        self.create_timer(0.02, self.tick, callback_group=self.group)

    def sources(self) -> None:
        self.odom = self.create_publisher(Odometry, "/odom", 10)
        self.imu = self.create_publisher(Imu, "/imu", BEST_EFFORT)
        self.scan = self.create_publisher(LaserScan, "/scan", BEST_EFFORT)
        self.echo = self.create_publisher(Twist, "/twist_heard", LATCHED)
        self.latched = self.create_publisher(String, "/robot_description", LATCHED)
        self.latched.publish(String(data=DESCRIPTION))
        self.faults = self.create_publisher(String, "/faults", 10)
        self.count = 0

    def sinks(self) -> None:
        self.create_subscription(Twist, "/cmd_vel", self.heard, 10)
        self.create_subscription(Float64, "/best_effort_sink", lambda _m: None, BEST_EFFORT)

    def calls(self) -> None:
        offer = {"callback_group": self.group}
        self.create_service(Trigger, "/reset", self.reset, **offer)
        self.create_service(SetBool, "/set_bool", self.set_bool, **offer)
        self.create_service(BasicTypes, "/add", self.add, **offer)
        self.slow_service = self.create_service(Trigger, "/slow", self.slow, **offer)
        self.create_service(Empty, "/fault", self.fault, **offer)
        self.fibonacci = ActionServer(
            self,
            Fibonacci,
            "/fibonacci",
            self.compute,
            goal_callback=self.admit,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
            **offer,
        )

    def settings(self) -> None:
        self.refused = ""
        self.declare_parameter(
            "max_speed",
            1.5,
            ParameterDescriptor(
                description="Fastest the robot may drive",
                floating_point_range=[FloatingPointRange(from_value=0.0, to_value=2.5)],
            ),
        )
        self.declare_parameter(
            "gear",
            2,
            ParameterDescriptor(integer_range=[IntegerRange(from_value=0, to_value=10, step=2)]),
        )
        self.declare_parameter("serial", "A-1", ParameterDescriptor(read_only=True))
        self.declare_parameter("mode", "auto")
        self.declare_parameter("gains", [0.5, 0.25])
        self.add_on_set_parameters_callback(self.judge)

    def judge(self, parameters: list) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == self.refused:
                return SetParametersResult(successful=False, reason="a test refuses it")
            if parameter.name == "mode" and parameter.value not in ("auto", "manual"):
                return SetParametersResult(successful=False, reason="mode must be auto or manual")
        return SetParametersResult(successful=True)

    def tick(self) -> None:
        now = self.get_clock().now().to_msg()
        self.count += 1
        odom = Odometry()
        odom.header.stamp = now
        odom.header.frame_id = "odom"
        odom.child_frame_id = "base_link"
        odom.pose.pose.position.x = float(self.count)
        odom.pose.pose.orientation.w = 1.0
        odom.pose.covariance[0] = math.inf
        odom.twist.twist = self.twist
        odom.twist.covariance[0] = 0.5
        self.odom.publish(odom)
        imu = Imu()
        imu.header.stamp = now
        imu.linear_acceleration.z = 9.81
        self.imu.publish(imu)
        scan = LaserScan(ranges=[1.0, math.inf, math.nan], range_max=10.0)
        scan.header.stamp = now
        self.scan.publish(scan)

    def heard(self, message: Twist) -> None:
        self.twist = message
        self.echo.publish(message)

    def reset(self, _request: object, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, "reset done"
        return response

    def set_bool(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success = request.data != self.on
        response.message = "switched" if response.success else "it is so already"
        self.on = request.data
        return response

    def add(self, request: BasicTypes.Request, response: BasicTypes.Response) -> object:
        response.int64_value = request.int64_value + 1
        response.uint64_value = request.uint64_value
        response.float64_value = math.nan
        response.string_value = request.string_value[::-1]
        return response

    def slow(self, _request: object, response: Trigger.Response) -> Trigger.Response:
        time.sleep(3)  # longer than the deadline that is tried with it
        return response

    def fault(self, _request: object, response: Empty.Response) -> Empty.Response:
        self.faults.publish(String(data="motor hot"))
        return response

    def admit(self, goal: Fibonacci.Goal) -> GoalResponse:
        if self.manner in ("late", "odd"):
            time.sleep(0.5)  # until the other server of the action has rejected it
        refused = goal.order < 0 or self.manner == "strict"
        if self.manner in ("odd", "even"):
            refused = goal.order % 2 != (self.manner == "odd")
        return GoalResponse.REJECT if refused else GoalResponse.ACCEPT

    def compute(self, goal: object) -> Fibonacci.Result:
        """Order 0 aborts; 100 ms a number."""
        self.running += 1
        self.began += 1
        try:
            return self.count_up(goal)
        finally:
            self.running -= 1

    def count_up(self, goal: object) -> Fibonacci.Result:
        order = goal.request.order
        sequence = [0, 1]
        while len(sequence) <= order and not self.retired:
            if goal.is_cancel_requested:
                goal.canceled()
                return Fibonacci.Result(sequence=sequence)
            sequence.append((sequence[-1] + sequence[-2]) % 2**31)
            goal.publish_feedback(Fibonacci.Feedback(sequence=sequence[-5:]))
            time.sleep(0.1)  # the work that the goal stands for
        self.result = sequence
        if order:
            goal.succeed()
        else:
            goal.abort()
        return Fibonacci.Result(sequence=sequence)

    def truth(self) -> dict[str, object]:
        """Tell how things are, past every interface of ROS."""
        linear, angular = self.twist.linear, self.twist.angular
        return {
            "twist": {
                "linear": {"x": linear.x, "y": linear.y, "z": linear.z},
                "angular": {"x": angular.x, "y": angular.y, "z": angular.z},
            },
            "running": self.running,
            "began": self.began,
            "result": self.result,
            **{name: self.get_parameter(name).value for name in ("max_speed", "gear", "mode")},
        }


def main() -> None:
    rclpy.init()
    name = sys.argv[1] if len(sys.argv) > 1 else "peer"
    peer = Peer(name, sys.argv[2] if len(sys.argv) > 2 else name)
    executor = MultiThreadedExecutor(6)
    executor.add_node(peer)
    spinning = threading.Thread(target=executor.spin)
    spinning.start()
    print("ready", flush=True)  # noqa: T201
    for line in sys.stdin:
        if line.startswith("refuse "):
            peer.refused = line.split(" ", 1)[1].strip()
        if line == "withdraw\n":
            peer.destroy_service(peer.slow_service)
        if line == "retire\n":
            peer.retired = True
            peer.fibonacci.destroy()
        print(json.dumps(peer.truth()), flush=True)  # noqa: T201
    executor.shutdown(timeout_sec=1)
    spinning.join(2)
    peer.destroy_node()
    rclpy.shutdown()
    del peer, executor, spinning
    gc.collect()  # the participant leaves the graph with its last reference
    os._exit(0)  # whatever still sleeps in a callback


if __name__ == "__main__":
    main()
