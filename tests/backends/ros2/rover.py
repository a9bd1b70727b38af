"""Rovers of a fleet, each in a namespace of its own, and whatever else a graph may bring.

Run as `python rover.py NAMESPACE…`; takes orders as `robot_nodes.py` does.
"""

from __future__ import annotations

import importlib
import os
import sys
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import SetParametersResult
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.service_introspection import ServiceIntrospectionState
from sensor_msgs.msg import BatteryState, LaserScan
from std_msgs.msg import String
from std_srvs.srv import SetBool
from test_msgs.action import NestedMessage

STEP = 0.05  # s


class Rover(Node):
    """One robot; goals of `navigate` count down, and a new one takes the place of the old."""

    def __init__(self, space: str) -> None:
        super().__init__("rover", namespace=space)
        group = ReentrantCallbackGroup()
        self.odom = self.create_publisher(Odometry, "odom", 10)
        self.scan = self.create_publisher(LaserScan, "scan", 10)
        self.battery = self.create_publisher(BatteryState, "battery_state", 10)
        self.driven = Twist()
        self.create_subscription(Twist, "cmd_vel", self.drive, 10, callback_group=group)
        self.placed = Odometry()
        self.create_subscription(Odometry, "set_odom", self.place, 10, callback_group=group)
        self.dock = self.create_service(SetBool, "dock", self.docked, callback_group=group)
        self.current: Any = None
        self.server = ActionServer(
            self,
            NestedMessage,
            "navigate",
            self.navigate,
            goal_callback=self.admit,
            handle_accepted_callback=self.begin,
            cancel_callback=self.may_cancel,
            callback_group=group,
        )
        self.client = ActionClient(self, NestedMessage, "navigate", callback_group=group)
        self.declare_parameter("low", 1.0)
        self.declare_parameter("high", 2.0)
        self.add_on_set_parameters_callback(self.judge)
        self.create_timer(0.02, self.tick, callback_group=group)

    def judge(self, parameters: list) -> SetParametersResult:
        new = {p.name: p.value for p in parameters}
        low, high = (
            new.get(n, self.get_parameter_or(n, Parameter(n, value=0.0)).value)
            for n in ("low", "high")
        )
        fits = not new.keys() & {"low", "high"} or low < high
        return SetParametersResult(successful=fits, reason="" if fits else "low is above high")

    def tick(self) -> None:
        odom = Odometry()
        odom.header.stamp = self.get_clock().now().to_msg()
        odom.header.frame_id = f"{self.get_namespace()[1:]}/odom"
        odom.pose.pose.position.x = float(len(self.get_namespace()))
        odom.twist.twist.linear.x = self.driven.linear.x
        self.odom.publish(odom)
        self.battery.publish(BatteryState(percentage=0.5))
        self.scan.publish(LaserScan(ranges=[1.0]))

    def drive(self, twist: Twist) -> None:
        self.driven = twist

    def place(self, odom: Odometry) -> None:
        self.placed = odom

    def docked(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = True, f"docked: {request.data}"
        return response

    def admit(self, goal: NestedMessage.Goal) -> GoalResponse:
        far = goal.nested_field.int32_value > 1000
        return GoalResponse.REJECT if far else GoalResponse.ACCEPT

    def begin(self, goal: Any) -> None:
        if self.current is not None and self.current.is_active:
            self.current.abort()
        self.current = goal
        goal.execute()

    def may_cancel(self, goal: Any) -> CancelResponse:
        firm = goal.request.nested_field.bool_value
        return CancelResponse.REJECT if firm else CancelResponse.ACCEPT

    def navigate(self, goal: Any) -> NestedMessage.Result:
        result = NestedMessage.Result()
        for left in range(goal.request.nested_field.int32_value, 0, -1):
            if not goal.is_active:
                return result  # another goal came
            if goal.is_cancel_requested:
                goal.canceled()
                return result
            feedback = NestedMessage.Feedback()
            feedback.nested_field.int32_value = left
            goal.publish_feedback(feedback)
            time.sleep(STEP)
        if goal.is_active:
            goal.succeed()
        return result


class Fleet:
    """All the rovers, and what they can be told to do."""

    def __init__(self, spaces: list[str]) -> None:
        self.rovers: dict[str, Rover] = {}
        self.executors: dict[str, tuple[MultiThreadedExecutor, threading.Thread]] = {}
        self.extra = Node("extra")
        apart = Context()  # within one, a topic has one type
        rclpy.init(context=apart)
        self.other = Node("other", context=apart)
        self.made: dict[str, list[tuple[Any, Any]]] = {}
        self.texts: list[str] = []
        for space in spaces:
            self.add(space)

    def add(self, space: str) -> None:
        """Have another rover come."""
        self.rovers[space] = Rover(space)
        executor = MultiThreadedExecutor(4)  # of its own: a node cannot leave one that works
        executor.add_node(self.rovers[space])
        thread = threading.Thread(target=executor.spin, daemon=True)
        thread.start()
        self.executors[space] = (executor, thread)

    def drop(self, space: str) -> None:
        """Have a rover leave."""
        rover = self.rovers.pop(space)
        executor, thread = self.executors.pop(space)
        executor.shutdown(timeout_sec=2)
        thread.join(2)
        rover.server.destroy()
        rover.client.destroy()
        rover.destroy_node()

    def driven(self, space: str) -> float:
        """Tell how fast a rover was told to drive."""
        return self.rovers[space].driven.linear.x

    def placed(self, space: str) -> list[Any]:
        """Tell where a rover was told that it is."""
        odom = self.rovers[space].placed
        return [odom.child_frame_id, odom.pose.pose.position.x, list(odom.pose.covariance[:2])]

    def go(self, space: str, steps: int) -> None:
        """Send a goal as somebody else than the gateway."""
        goal = NestedMessage.Goal()
        goal.nested_field.int32_value = steps
        self.rovers[space].client.wait_for_server(5)
        self.rovers[space].client.send_goal_async(goal)

    def introspect(self, space: str) -> None:
        """Have the service `dock` tell of its calls."""
        self.rovers[space].dock.configure_introspection(
            Clock(), QoSProfile(depth=10), ServiceIntrospectionState.CONTENTS
        )

    def declare(self, space: str, name: str, value: Any) -> None:
        """Declare a parameter."""
        self.rovers[space].declare_parameter(name, value)

    def undeclare(self, space: str, name: str) -> None:
        """Take a parameter back."""
        self.rovers[space].undeclare_parameter(name)

    def put(self, space: str, name: str, value: Any) -> None:
        """Set a parameter from within."""
        self.rovers[space].set_parameters([Parameter(name, value=value)])

    def parameter(self, space: str, name: str) -> Any:
        """Tell what a parameter is."""
        return self.rovers[space].get_parameter(name).value

    def offer(
        self,
        topic: str,
        kind: str,
        *,
        latched: bool = False,
        reliable: bool = True,
        beside: bool = False,
    ) -> None:
        """Publish a topic from now on, in place of what was published there, or beside it."""
        if not beside:
            self.withdraw(topic)
        package, name = kind.split("/")
        cls = getattr(importlib.import_module(f"{package}.msg"), name)
        qos = QoSProfile(
            depth=10,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        )
        node = self.other if beside else self.extra
        publisher = node.create_publisher(cls, topic, qos)
        self.made.setdefault(topic, []).append((cls, publisher))

    def offer_many(self, stem: str, count: int) -> None:
        """Publish many topics."""
        for number in range(count):
            self.offer(f"{stem}{number}", "std_msgs/String")

    def withdraw(self, topic: str = "", *, stem: str | None = None) -> None:
        """Publish topics no more: those named, or those that begin so."""
        for name in list(self.made):
            if name == topic or (stem is not None and name.startswith(stem)):
                for _, publisher in self.made.pop(name):
                    publisher.destroy()

    def hear(self, topic: str, deadline: float) -> None:
        """Listen to texts on a topic, asking for one so often, and for signs of life."""
        qos = QoSProfile(
            depth=10,
            deadline=Duration(seconds=deadline),
            liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
            liveliness_lease_duration=Duration(seconds=2 * deadline),
        )
        rover = next(iter(self.rovers.values()))
        rover.create_subscription(String, topic, lambda m: self.texts.append(m.data), qos)

    def heard(self) -> list[str]:
        """Tell the texts that were heard."""
        return self.texts

    def say(self, topic: str, data: Any, *, times: int = 1, rate: float = 0.0) -> None:
        """Publish on a topic, so often, at a rate; numbers count up."""
        cls, publisher = self.made[topic][0]
        for number in range(times):
            value = data + number if isinstance(data, int | float) else data
            publisher.publish(cls(data=value))
            if rate:
                time.sleep(1 / rate)


def main() -> None:
    from robot_nodes import serve

    rclpy.init()
    serve(Fleet(sys.argv[1:]))
    os._exit(0)  # whatever still spins


if __name__ == "__main__":
    main()
