"""Nav2's controller_server, as far as speed limits go.

Run as `python navigator.py ROOT`; takes orders as `robot_nodes.py` does. ROOT has the built interfaces.
"""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path
from typing import Any

import interfaces
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

interfaces.use(Path(sys.argv[1]))
from nav2_msgs.msg import SpeedLimit  # noqa: E402 - built just now


class Navigator:
    """The node, and a costmap's filter that limits the speed too."""

    def __init__(self) -> None:
        self.node = Node("controller_server")
        self.filter = Node("speed_filter")
        self.heard: list[list[Any]] = []
        self.node.create_subscription(SpeedLimit, "speed_limit", self.limit, 10)
        self.zones = self.filter.create_publisher(SpeedLimit, "speed_limit", 10)
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        executor.add_node(self.filter)
        threading.Thread(target=executor.spin, daemon=True).start()

    def limit(self, message: SpeedLimit) -> None:
        self.heard.append([message.percentage, message.speed_limit])

    def configure(self, speed: float) -> None:
        """Declare the parameters, as a lifecycle node does when it is configured."""
        self.node.declare_parameter("FollowPath.max_vel_x", speed)

    def enter_zone(self, share: float) -> None:
        """Limit the speed to a percentage."""
        self.zones.publish(SpeedLimit(percentage=True, speed_limit=share))

    def truth(self) -> list[list[Any]]:
        """Return what was heard."""
        return self.heard


def main() -> None:
    from robot_nodes import serve

    rclpy.init()
    serve(Navigator())
    os._exit(0)  # whatever still spins


if __name__ == "__main__":
    main()
