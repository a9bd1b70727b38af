"""A rover with the names that ROS 2 robots have in common, and a navigator; its truth is in its process.

Run as `python wheels.py ROOT [stamped]`; takes orders as `robot_nodes.py` does. ROOT has the built interfaces.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

import interfaces
import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import BatteryState, CompressedImage, JointState, LaserScan
from std_srvs.srv import Trigger

interfaces.use(Path(sys.argv[1]))
from nav2_msgs.action import NavigateToPose  # noqa: E402 - built just now

PERIOD = 0.02  # s
GRIP, TWIST = 1.5, 3.0  # m/s² and rad/s² that the wheels can do
LAPSE = 10.0  # s after which a velocity is no longer obeyed
NEAR = 0.05  # m
WALL = 3.0  # m, the radius of the room around the rover
JPEG = bytes.fromhex("ffd8ffc0000b080018002001011100ffd9")  # 32 by 24, empty


class Rover(Node):
    """A differential drive."""

    def __init__(self, *, stamped: bool) -> None:
        super().__init__("rover")
        self.x = self.y = self.yaw = self.v = self.w = 0.0
        self.wanted = (0.0, 0.0)
        self.heard = 0.0
        self.running = self.resets = 0
        self.stamps: list[int] = []
        self.declare_parameter(
            "speed_limit",
            1.0,
            ParameterDescriptor(
                floating_point_range=[FloatingPointRange(from_value=0.0, to_value=1.0)]
            ),
        )
        group = ReentrantCallbackGroup()
        self.odom = self.create_publisher(Odometry, "odom", 10)
        self.others = {
            "scan": self.create_publisher(LaserScan, "scan", 10),
            "battery_state": self.create_publisher(BatteryState, "battery_state", 10),
            "joint_states": self.create_publisher(JointState, "joint_states", 10),
            "camera": self.create_publisher(CompressedImage, "camera/image_raw/compressed", 10),
        }
        kind = TwistStamped if stamped else Twist
        self.create_subscription(kind, "cmd_vel", self.drive, 10, callback_group=group)
        self.create_service(Trigger, "reset_system", self.reset, callback_group=group)
        self.server = ActionServer(
            self,
            NavigateToPose,
            "navigate_to_pose",
            self.navigate,
            goal_callback=self.admit,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
            callback_group=group,
        )
        self.create_timer(0.05, self.measure, callback_group=group)
        threading.Thread(target=self.turn, daemon=True).start()

    def drive(self, message: Any) -> None:
        if isinstance(message, TwistStamped):
            self.stamps.append(message.header.stamp.sec)
            message = message.twist
        self.heard = time.monotonic()
        self.wanted = (message.linear.x, message.angular.z)

    def reset(self, _request: Any, response: Trigger.Response) -> Trigger.Response:
        self.wanted = (0.0, 0.0)
        self.resets += 1
        response.success = True
        return response

    def admit(self, goal: Any) -> GoalResponse:
        far = math.hypot(goal.pose.pose.position.x - self.x, goal.pose.pose.position.y - self.y)
        fits = goal.pose.header.frame_id == "odom" and far < 100.0
        return GoalResponse.ACCEPT if fits else GoalResponse.REJECT

    def navigate(self, goal: Any) -> Any:
        self.running += 1
        at, turned = goal.request.pose.pose.position, goal.request.pose.pose.orientation
        end = 2 * math.atan2(turned.z, turned.w)
        try:
            while (left := math.hypot(at.x - self.x, at.y - self.y)) > NEAR:
                if goal.is_cancel_requested:
                    goal.canceled()
                    return NavigateToPose.Result()
                off = math.remainder(math.atan2(at.y - self.y, at.x - self.x) - self.yaw, math.tau)
                speed = min(0.6, left) if abs(off) < 0.3 else 0.0
                self.command(speed, 2.0 * off)
                self.tell(goal, left)
                time.sleep(PERIOD)
            while abs(off := math.remainder(end - self.yaw, math.tau)) > 0.03 or abs(self.v) > 0.01:
                if goal.is_cancel_requested:
                    goal.canceled()
                    return NavigateToPose.Result()
                self.command(0.0, 2.0 * off)
                time.sleep(PERIOD)
            goal.succeed()
            return NavigateToPose.Result()
        finally:
            self.command(0.0, 0.0)
            self.running -= 1

    def command(self, speed: float, turn: float) -> None:
        self.heard, self.wanted = time.monotonic(), (speed, max(-1.0, min(1.0, turn)))

    def tell(self, goal: Any, left: float) -> None:
        feedback = NavigateToPose.Feedback()
        feedback.current_pose.header.frame_id = "odom"
        feedback.current_pose.pose.position.x = self.x
        feedback.current_pose.pose.position.y = self.y
        feedback.distance_remaining = left
        feedback.estimated_time_remaining.sec = math.ceil(left / 0.3)
        goal.publish_feedback(feedback)

    def turn(self) -> None:
        """Turn the wheels, whether anybody is heard or not."""
        while True:
            lapsed = time.monotonic() - self.heard > LAPSE
            v, w = (0.0, 0.0) if lapsed else self.wanted
            most = self.get_parameter("speed_limit").value
            v = max(-most, min(most, v))
            self.v += max(-GRIP * PERIOD, min(GRIP * PERIOD, v - self.v))
            self.w += max(-TWIST * PERIOD, min(TWIST * PERIOD, w - self.w))
            self.yaw = math.remainder(self.yaw + self.w * PERIOD, math.tau)
            self.x += self.v * math.cos(self.yaw) * PERIOD
            self.y += self.v * math.sin(self.yaw) * PERIOD
            time.sleep(PERIOD)

    def measure(self) -> None:
        odom = Odometry(child_frame_id="base_link")
        odom.header.stamp = stamp = self.get_clock().now().to_msg()
        odom.header.frame_id = "odom"
        odom.pose.pose.position.x, odom.pose.pose.position.y = self.x, self.y
        odom.pose.pose.orientation.z = math.sin(self.yaw / 2)
        odom.pose.pose.orientation.w = math.cos(self.yaw / 2)
        odom.twist.twist.linear.x, odom.twist.twist.angular.z = self.v, self.w
        self.odom.publish(odom)
        scan = LaserScan(
            angle_min=-math.pi,
            angle_max=math.pi,
            angle_increment=math.pi / 8,
            range_max=10.0,
            ranges=[WALL] * 17,
        )
        image = CompressedImage(format="jpeg", data=JPEG)
        joints = JointState(name=["left", "right"], position=[0.1, 0.2], velocity=[0.0, 0.0])
        values = {
            "scan": scan,
            "battery_state": BatteryState(percentage=0.75, voltage=math.nan, current=-1.5),
            "joint_states": joints,
            "camera": image,
        }
        for name, publisher in list(self.others.items()):
            values[name].header.stamp = stamp
            publisher.publish(values[name])


class Robot:
    """The rover, and what it can be told to do."""

    def __init__(self, *, stamped: bool) -> None:
        self.rover: Any = Rover(stamped=stamped)
        self.executor = MultiThreadedExecutor(4)
        self.executor.add_node(self.rover)
        threading.Thread(target=self.executor.spin, daemon=True).start()

    def truth(self) -> dict[str, Any]:
        """Tell how things are, past every interface of ROS."""
        rover = self.rover
        names = ("x", "y", "yaw", "v", "w", "running", "resets", "stamps")
        return {name: getattr(rover, name) for name in names}

    def leave(self) -> None:
        """Have all of it leave the graph, in good order."""
        self.executor.shutdown(timeout_sec=2)
        self.rover.server.destroy()
        self.rover.destroy_node()
        self.rover = None

    def withdraw(self, name: str) -> None:
        """Publish a topic no more."""
        self.rover.others.pop(name).destroy()


def main() -> None:
    from robot_nodes import serve

    rclpy.init()
    serve(Robot(stamped="stamped" in sys.argv))
    os._exit(0)  # whatever still spins


if __name__ == "__main__":
    main()
