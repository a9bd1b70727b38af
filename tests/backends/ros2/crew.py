"""The nodes of a robot that follow ROS's conventions: with a lifecycle, diagnostics, logs, frames.

Run as `python crew.py`; prints `ready` when everything is offered, does what each line (JSON, with
the name of a method in `do`) says, answers it with one line, and ends with its stdin.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import threading

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn


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


class Crew:
    """All the nodes, and what they can be told to do."""

    def __init__(self) -> None:
        self.driver = Driver()
        self.nodes = [self.driver]

    def break_(self, *, broken: bool) -> None:
        """Have the driver fail to be activated."""
        self.driver.broken = broken

    def lead(self, transition: str) -> None:
        """Lead the driver through a transition from within."""
        getattr(self.driver, f"trigger_{transition}")()


def main() -> None:
    rclpy.init()
    crew = Crew()
    executor = SingleThreadedExecutor()
    for node in crew.nodes:
        executor.add_node(node)
    spinning = threading.Thread(target=executor.spin)
    spinning.start()
    print("ready", flush=True)  # noqa: T201
    for line in sys.stdin:
        order = json.loads(line)
        answer = getattr(crew, order.pop("do"))(**order)
        print(json.dumps(answer), flush=True)  # noqa: T201
    executor.shutdown(timeout_sec=1)
    spinning.join(2)
    for node in crew.nodes:
        node.destroy_node()
    rclpy.shutdown()
    del crew, executor, spinning, node
    gc.collect()  # the participant leaves the graph with its last reference
    os._exit(0)


if __name__ == "__main__":
    main()
