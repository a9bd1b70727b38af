"""A simulator with a rover in it, as Gazebo or Isaac Sim appear in ROS: `/clock`, and all else in its time.

Run as `python simulated.py`; takes orders as `robot_nodes.py` does.
"""

from __future__ import annotations

import os
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from robot_nodes import transforms
from rosgraph_msgs.msg import Clock

import rcp_ros2.definitions  # noqa: F401 - has the type of transforms
from rcp_ros2.idl import load

STEP = 20_000_000  # ns
BEGIN = 100_000_000_000  # ns
STALE = 1.0  # s of its time after which a velocity is no longer obeyed


class Simulator(Node):
    """The physics, one step after the other while it runs."""

    def __init__(self) -> None:
        super().__init__("simulator")
        self.now = BEGIN
        self.runs = True
        self.x = self.v = 0.0
        self.wanted, self.stamps = 0.0, list[int]()
        self.clock = self.create_publisher(Clock, "/clock", 10)
        self.odom = self.create_publisher(Odometry, "odom", 10)
        self.frames = self.create_publisher(load("tf2_msgs/msg/TFMessage"), "/tf", 10)
        self.create_subscription(TwistStamped, "cmd_vel", self.drive, 10)
        threading.Thread(target=self.run, daemon=True).start()

    def drive(self, message: TwistStamped) -> None:
        self.wanted = message.twist.linear.x
        stamp = message.header.stamp
        self.stamps.append(stamp.sec * 10**9 + stamp.nanosec)

    def run(self) -> None:
        while True:
            time.sleep(STEP / 1e9)
            if self.runs:
                self.step()

    def step(self) -> None:
        self.now += STEP
        fresh = bool(self.stamps) and abs(self.now - self.stamps[-1]) / 1e9 < STALE
        self.v = self.wanted if fresh else 0.0
        self.x += self.v * STEP / 1e9
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = divmod(self.now, 10**9)
        self.clock.publish(clock)
        odom = Odometry(child_frame_id="base_link")
        odom.header.frame_id, odom.header.stamp = "odom", clock.clock
        odom.pose.pose.position.x, odom.twist.twist.linear.x = self.x, self.v
        odom.pose.pose.orientation.w = 1.0
        self.odom.publish(odom)
        place = [self.x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        self.frames.publish(transforms(("odom", "base_link", self.now, place)))


class Robot:
    """What can be done with the simulator."""

    def __init__(self) -> None:
        self.simulator = Simulator()
        executor = SingleThreadedExecutor()
        executor.add_node(self.simulator)
        threading.Thread(target=executor.spin, daemon=True).start()

    def truth(self) -> dict[str, Any]:
        """Tell how things are, past every interface of ROS."""
        names = ("now", "x", "v", "wanted", "stamps")
        return {name: getattr(self.simulator, name) for name in names}

    def pause(self) -> None:
        """Stop the time."""
        self.simulator.runs = False

    def resume(self) -> None:
        """Let the time go on."""
        self.simulator.runs = True

    def reset(self) -> None:
        """Begin again."""
        self.simulator.now, self.simulator.x, self.simulator.wanted = BEGIN // 10, 0.0, 0.0


def main() -> None:
    from robot_nodes import serve

    rclpy.init()
    serve(Robot())
    os._exit(0)  # whatever still spins


if __name__ == "__main__":
    main()
