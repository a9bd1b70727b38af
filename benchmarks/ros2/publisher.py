"""A robot in a process of its own: one topic of any installed type at a paced rate, or a service.

python publisher.py nav_msgs/msg/Odometry /odom 1000 [--size BYTES] [--best-effort]
python publisher.py --service /reset

A message is serialised once; each copy gets its own `header.stamp`, by which clients tell its age.
`--size` fills the `data` of the message (an image of 640 x 480, a cloud of points of 16 bytes).
Publishes until its input ends.
"""

from __future__ import annotations

import argparse
import importlib
import struct
import sys
import threading
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message

WIDTH, HEIGHT = 640, 480
POINT = 16  # bytes


def sample_of(cls, size: int):
    message = cls()
    if hasattr(message, "header"):
        message.header.frame_id = "odom"
    if hasattr(message, "child_frame_id"):
        message.child_frame_id = "base_link"
    if hasattr(message, "pose") and hasattr(message.pose, "covariance"):
        message.pose.pose.position.x = 1.25
        message.pose.pose.orientation.w = 1.0
        message.pose.covariance[:] = 0.001
        message.twist.covariance[:] = 0.01
    if hasattr(message, "ranges"):
        message.ranges = [1.0 + i / 1000 for i in range(1080)]
    if cls.__name__ == "Image":
        message.width, message.height, message.step = WIDTH, HEIGHT, 3 * WIDTH
        message.encoding = "rgb8"
        size = 3 * WIDTH * HEIGHT
    if cls.__name__ == "PointCloud2":
        size -= size % POINT
        message.width, message.height, message.point_step = size // POINT, 1, POINT
        message.row_step = size
    if size:
        row = bytes(x * 255 // WIDTH % 256 for x in range(3 * WIDTH))
        message.data = (row * (size // len(row) + 1))[:size]
    return message


def publish(node, args: argparse.Namespace, ended: threading.Event) -> None:
    package, _, leaf = args.type.split("/")
    cls = getattr(importlib.import_module(f"{package}.msg"), leaf)
    qos = QoSProfile(depth=10)
    if args.best_effort:
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
    publisher = node.create_publisher(cls, args.topic, qos)
    message = sample_of(cls, args.size)
    data = bytearray(serialize_message(message))
    stamped = hasattr(message, "header")
    due = time.monotonic()
    while not ended.is_set():
        if stamped:
            now = time.time_ns()
            struct.pack_into("<iI", data, 4, now // 10**9, now % 10**9)
        publisher.publish(bytes(data))
        due = max(due + 1 / args.rate, time.monotonic() - 0.1)
        time.sleep(max(0.0, due - time.monotonic()))


def serve(node, name: str) -> None:
    from std_srvs.srv import Trigger

    def answer(_request, response):
        response.success, response.message = True, "done"
        return response

    node.create_service(Trigger, name, answer)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.spin()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("type", nargs="?")
    parser.add_argument("topic", nargs="?")
    parser.add_argument("rate", nargs="?", type=float)
    parser.add_argument("--size", type=int, default=0)
    parser.add_argument("--best-effort", action="store_true")
    parser.add_argument("--service")
    args = parser.parse_args()
    rclpy.init()
    node = rclpy.create_node("benchmark_robot")
    ended = threading.Event()
    if args.service:
        work = threading.Thread(target=serve, args=(node, args.service), daemon=True)
    else:
        work = threading.Thread(target=publish, args=(node, args, ended), daemon=True)
    work.start()
    sys.stdin.read()
    ended.set()
    if not args.service:
        work.join()


main()
