"""A node that publishes more than arrives, then nothing. Run: python bursting.py"""

from __future__ import annotations

import sys
import time

import rclpy
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import UInt8MultiArray


def say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("bursting")
    qos = QoSProfile(
        depth=10,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        deadline=Duration(seconds=0.1),
    )
    publisher = node.create_publisher(UInt8MultiArray, "/big", qos)
    message = UInt8MultiArray(data=bytes(1_000_000))
    say("ready")
    while sys.stdin.readline():  # one burst for each line
        while not publisher.get_subscription_count():
            time.sleep(0.05)
        for _ in range(200):
            publisher.publish(message)
        say("200")


if __name__ == "__main__":
    main()
