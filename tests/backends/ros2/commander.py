"""Somebody else who commands the robot, in a process of its own: a teleop, and a client of actions.

Run as `python commander.py`; takes orders as `robot_nodes.py` does.
"""

from __future__ import annotations

import os
import threading
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from test_msgs.action import NestedMessage


class Commander:
    """The one who commands."""

    def __init__(self) -> None:
        self.node = Node("teleop")
        self.publisher = self.node.create_publisher(Twist, "/cmd_vel", 10)
        self.client = ActionClient(self.node, NestedMessage, "/navigate")
        self.timer: Any = None
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        threading.Thread(target=self.executor.spin, daemon=True).start()

    def drive(self, rate: float, speed: float) -> None:
        """Publish a velocity at a rate."""
        self.rest()
        twist = Twist()
        twist.linear.x = speed
        self.timer = self.node.create_timer(1 / rate, lambda: self.publisher.publish(twist))

    def say(self, speed: float) -> None:
        """Publish a velocity once."""
        twist = Twist()
        twist.linear.x = speed
        self.publisher.publish(twist)

    def rest(self) -> None:
        """Publish no more."""
        if self.timer is not None:
            self.node.destroy_timer(self.timer)
            self.timer = None

    def hears(self) -> int:
        """Tell how many subscribers there are."""
        return self.publisher.get_subscription_count()

    def go(self, steps: int) -> bool:
        """Send a goal; tell whether there is a server."""
        goal = NestedMessage.Goal()
        goal.nested_field.int32_value = steps
        if not self.client.wait_for_server(10):
            return False
        self.client.send_goal_async(goal)
        return True


def main() -> None:
    from robot_nodes import serve

    rclpy.init()
    serve(Commander())
    os._exit(0)


if __name__ == "__main__":
    main()
