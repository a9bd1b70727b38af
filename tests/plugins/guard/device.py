"""A robot without a watchdog, in a process of its own: it goes on as it was last told to.

Run as `python device.py udp | can GROUP | ros2 DOMAIN`. It is driven by datagrams `v <m/s>` and stopped
by what the guard sends. It prints a JSON line for everything that it is told, with the time of the
system's monotonic clock, which all processes share. It ends with its stdin.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import threading
import time
from typing import Any

velocity = 0.0


def told(by: str, what: Any, speed: float | None) -> None:
    """Take a new velocity into force, and print it."""
    global velocity  # noqa: PLW0603 - the state of the whole process
    velocity = velocity if speed is None else speed
    fact = {"at": time.monotonic(), "by": by, "told": what, "velocity": velocity}
    os.write(1, json.dumps(fact).encode() + b"\n")


def over_udp(ready: Any) -> None:
    """Listen to datagrams: drives and stops."""
    heard = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    heard.bind(("127.0.0.1", 0))
    ready(heard.getsockname()[1])
    while True:
        data = heard.recv(2048).decode()
        told("udp", data, float(data.partition(" ")[2]) if data.startswith("v") else 0.0)


def over_can(group: str) -> None:
    """Listen for the stop frame on a CAN bus."""
    import can

    bus = can.Bus(interface="udp_multicast", channel=group)
    told("can", "open", None)
    while True:
        frame = bus.recv()
        if frame is not None:
            stop = frame.arbitration_id == 0x123 and bytes(frame.data) == b"\x00\x07"
            text = f"{frame.arbitration_id:x}#{bytes(frame.data).hex()}"
            told("can", text, 0.0 if stop else None)


def over_ros2(domain: str) -> None:
    """Subscribe to velocities, serve a stop, and run a goal until it is cancelled."""
    import rclpy
    from geometry_msgs.msg import Twist
    from rclpy.action import ActionClient, ActionServer, CancelResponse
    from rclpy.callback_groups import ReentrantCallbackGroup
    from rclpy.executors import MultiThreadedExecutor
    from std_srvs.srv import SetBool
    from test_msgs.action import Fibonacci

    rclpy.init(domain_id=int(domain))
    node = rclpy.create_node("device")
    group = ReentrantCallbackGroup()

    def heard(twist: Twist) -> None:
        told("topic", twist.linear.x, twist.linear.x)

    def stop(request: Any, response: Any) -> Any:
        told("service", request.data, None)
        return response

    def run(goal: Any) -> Any:
        told("action", "running", None)
        while not goal.is_cancel_requested:
            time.sleep(0.01)
        goal.canceled()
        told("action", "cancelled", None)
        return Fibonacci.Result()

    node.create_subscription(Twist, "/cmd_vel", heard, 10, callback_group=group)
    node.create_service(SetBool, "/halt", stop, callback_group=group)
    ActionServer(
        node,
        Fibonacci,
        "/go",
        run,
        cancel_callback=lambda _goal: CancelResponse.ACCEPT,
        callback_group=group,
    )
    client = ActionClient(node, Fibonacci, "/go", callback_group=group)
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    client.wait_for_server()
    client.send_goal_async(Fibonacci.Goal(order=5))


def main() -> None:
    ready = threading.Event()

    def open_rest(port: int) -> None:
        match sys.argv[1:]:
            case ["can", group]:
                threading.Thread(target=over_can, args=(group,), daemon=True).start()
            case ["ros2", domain]:
                over_ros2(domain)
        os.write(1, json.dumps({"port": port}).encode() + b"\n")
        ready.set()

    threading.Thread(target=over_udp, args=(open_rest,), daemon=True).start()
    ready.wait(30)
    sys.stdin.buffer.read()
    os._exit(0)


if __name__ == "__main__":
    main()
