"""The nodes of a robot that follow ROS's conventions: with a lifecycle, diagnostics, logs, frames.

Run as `python robot_nodes.py`; prints `ready` when everything is offered, does what each line (JSON, with
the name of a method in `do`) says, answers it with one line, and ends with its stdin.
"""

from __future__ import annotations

import gc
import json
import os
import struct
import sys
import threading

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock as ClockMessage
from std_msgs.msg import String

import rcp_ros2.definitions  # noqa: F401 - has the type of transforms
from rcp_ros2.idl import load

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Driver(LifecycleNode):
    """A camera's driver: it cannot be activated while it is broken."""

    def __init__(self) -> None:
        super().__init__("driver", namespace="/camera")
        self.broken = False

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self.broken:
            return TransitionCallbackReturn.FAILURE
        return super().on_activate(state)


class Monitor(Node):
    """Watches the robot's parts, and logs."""

    def __init__(self) -> None:
        super().__init__("monitor")
        self.board = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.said: dict[str, DiagnosticStatus] = {}
        self.clock = self.create_publisher(ClockMessage, "/clock", 10)
        self.note = self.create_publisher(String, "/note", 10)
        self.description = self.create_publisher(String, "/robot_description", LATCHED)
        self.create_timer(0.2, self.repeat)

    def repeat(self) -> None:
        array = DiagnosticArray(status=list(self.said.values()))
        array.header.stamp = self.get_clock().now().to_msg()
        self.board.publish(array)


class Caster(Node):
    """Publishes transforms; no package has their type, so that the bytes are made by hand."""

    def __init__(self, name: str, *, moving: bool) -> None:
        super().__init__(name)
        kind = load("tf2_msgs/msg/TFMessage")
        self.static = self.create_publisher(kind, "/tf_static", LATCHED)
        self.moving = self.create_publisher(kind, "/tf", 100) if moving else None


def transforms(*items: tuple[str, str, int, list[float]]) -> bytes:
    """Encode a tf2_msgs/TFMessage: parent, child, time in ns, place."""
    out = bytearray(b"\0\1\0\0")

    def put(kind: str, value: object, size: int) -> None:
        out.extend(b"\0" * (-(len(out) - 4) % size) + struct.pack("<" + kind, value))

    put("I", len(items), 4)
    for parent, child, time, place in items:
        put("i", time // 10**9, 4)
        put("I", time % 10**9, 4)
        for text in (parent, child):
            put("I", len(text) + 1, 4)
            out.extend(text.encode() + b"\0")
        for number in place:
            put("d", number, 8)
    return bytes(out)


class RobotNodes:
    """All the nodes, and what they can be told to do."""

    def __init__(self) -> None:
        self.driver = Driver()
        self.monitor = Monitor()
        self.base = Caster("base", moving=True)
        self.arm = Caster("arm", moving=False)
        self.nodes = [self.driver, self.monitor, self.base, self.arm]

    def break_(self, *, broken: bool) -> None:
        """Have the driver fail to be activated."""
        self.driver.broken = broken

    def diagnose(self, name: str, level: int, message: str = "", **values: str) -> None:
        """Have a part say how it is, from now on."""
        self.monitor.said[name] = DiagnosticStatus(
            level=bytes((level,)),
            name=name,
            message=message,
            hardware_id="hw-1",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )

    def hush(self, name: str) -> None:
        """Have a part say nothing any more."""
        del self.monitor.said[name]

    def fix(self, by: str, parent: str, child: str, place: list[float]) -> None:
        """Have a node say where a frame stands for ever."""
        getattr(self, by).static.publish(transforms((parent, child, 0, place)))

    def move(self, parent: str, child: str, time: int, place: list[float]) -> None:
        """Say where a frame is at a time, ns."""
        self.base.moving.publish(transforms((parent, child, time, place)))

    def tick(self, time: int) -> None:
        """Say what time it is, ns, and then something that carries no time."""
        message = ClockMessage()
        message.clock.sec, message.clock.nanosec = divmod(time, 10**9)
        self.monitor.clock.publish(message)
        self.monitor.note.publish(String(data="tick"))

    def describe(self, text: str) -> None:
        """Publish a description of the robot."""
        self.monitor.description.publish(String(data=text))

    def log(self, level: str, text: str) -> None:
        """Log a text."""
        logger = self.monitor.get_logger()
        match level:  # rclpy wants one line of code to log at one level
            case "info":
                logger.info(text)
            case "warn":
                logger.warning(text)
            case _:
                logger.error(text)

    def lead(self, transition: str) -> None:
        """Lead the driver through a transition from within."""
        getattr(self.driver, f"trigger_{transition}")()


def serve(robot_nodes: object) -> None:
    """Do what each line of the input says, until it ends."""
    print("ready", flush=True)  # noqa: T201
    for line in sys.stdin:
        order = json.loads(line)
        answer = getattr(robot_nodes, order.pop("do"))(**order)
        print(json.dumps(answer), flush=True)  # noqa: T201


def main() -> None:
    rclpy.init()
    robot_nodes = RobotNodes()
    executor = SingleThreadedExecutor()
    for node in robot_nodes.nodes:
        executor.add_node(node)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    serve(robot_nodes)
    executor.shutdown(timeout_sec=1)
    spinning.join(2)
    for node in robot_nodes.nodes:
        node.destroy_node()
    rclpy.shutdown()
    del robot_nodes, executor, spinning, node
    gc.collect()  # the participant leaves the graph with its last reference
    os._exit(0)


if __name__ == "__main__":
    main()
