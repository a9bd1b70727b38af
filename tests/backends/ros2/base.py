"""A driving base with wheels that obey whoever spoke last, and a navigator that drives it.

Run as `python base.py`; takes orders as `robot_nodes.py` does. It has no command timeout of its own: what it
was told once, it does until told otherwise, also while it is cut off from everybody.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool
from std_srvs.srv import SetBool
from test_msgs.action import NestedMessage

PERIOD = 0.02  # s of the wheels' control loop
GRIP = 2.0  # m/s² that the wheels can do
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Base(Node):
    """The wheels."""

    def __init__(self) -> None:
        super().__init__("base")
        self.told = 0.0
        self.wheel = 0.0
        self.brakes: dict[str, bool] = {}
        self.history: deque[tuple[float, float]] = deque(maxlen=5000)
        self.heard = 0
        self.lossy = False
        self.frozen = False
        self.works = True
        self.grip = GRIP
        self.delay = 0.0
        """s for which odometry is kept before it is published."""
        self.kept: deque[tuple[float, Odometry]] = deque()
        self.last = Odometry()
        self.zeroed = 0.0
        self.odom = self.create_publisher(Odometry, "odom", 10)
        self.create_subscription(Twist, "cmd_vel", self.drive, 10)
        self.create_subscription(Bool, "lock", lambda m: self.brake("lock", on=m.data), 10)
        self.create_subscription(Bool, "e_stop", lambda m: self.brake("e_stop", on=m.data), LATCHED)
        self.create_service(SetBool, "estop", self.estop)
        self.create_service(SetBool, "dock", self.dock)
        self.create_timer(PERIOD, self.measure)
        threading.Thread(target=self.turn, daemon=True).start()

    def drive(self, twist: Twist) -> None:
        self.heard += 1
        if not self.lossy or self.heard % 3 == 0:  # two of three are lost
            if self.told and not twist.linear.x:
                self.zeroed = time.monotonic()
            self.told = twist.linear.x

    def brake(self, name: str, *, on: bool) -> None:
        self.brakes[name] = on

    def estop(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success = self.works
        response.message = "" if self.works else "the relay is stuck"
        if self.works:
            self.brakes["service"] = request.data
        return response

    def dock(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.told = 0.2 if request.data else 0.0
        response.success = True
        return response

    def turn(self) -> None:
        """Turn the wheels, whether anybody is heard or not."""
        while True:
            wanted = 0.0 if any(self.brakes.values()) else self.told
            self.wheel += max(-self.grip * PERIOD, min(self.grip * PERIOD, wanted - self.wheel))
            self.history.append((time.monotonic(), self.wheel))
            time.sleep(PERIOD)

    def measure(self) -> None:
        if not self.frozen:
            self.last = Odometry()
            self.last.header.stamp = self.get_clock().now().to_msg()
            self.last.twist.twist.linear.x = self.wheel
        self.kept.append((time.monotonic(), self.last))
        while self.kept and self.kept[0][0] + self.delay <= time.monotonic():
            self.odom.publish(self.kept.popleft()[1])


class Navigator(Node):
    """Drives the base for each goal: so many steps of 50 ms at 0.4 m/s."""

    def __init__(self, base: Base) -> None:
        super().__init__("navigator")
        self.base = base
        self.running = 0
        self.finished = 0
        self.began = 0
        self.velocity = self.create_publisher(Twist, "cmd_vel", 10)  # as Nav2's, idle or not
        self.server = ActionServer(
            self,
            NestedMessage,
            "navigate",
            self.navigate,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    def navigate(self, goal: Any) -> NestedMessage.Result:
        self.running += 1
        self.began += 1
        try:
            for _ in range(goal.request.nested_field.int32_value):
                if goal.is_cancel_requested:
                    goal.canceled()
                    return NestedMessage.Result()
                self.base.told = 0.4
                feedback = NestedMessage.Feedback()
                goal.publish_feedback(feedback)
                time.sleep(0.05)  # the work that the goal stands for
            goal.succeed()
            self.finished += 1
            return NestedMessage.Result()
        finally:
            self.running -= 1
            self.base.told = 0.0


class Robot:
    """Both, and what they can be told to do."""

    def __init__(self) -> None:
        self.base = Base()
        self.navigator = Navigator(self.base)
        self.cut = False
        for node, executor in (
            (self.base, SingleThreadedExecutor()),
            (self.navigator, MultiThreadedExecutor(4)),
        ):
            executor.add_node(node)
            threading.Thread(target=self.spin, args=(executor,), daemon=True).start()

    def spin(self, executor: Any) -> None:
        while True:
            if self.cut:
                time.sleep(0.01)
            else:
                executor.spin_once(0.05)

    def sever(self, *, cut: bool) -> None:
        """Hear nobody and tell nobody anything, or do so again; the wheels go on."""
        self.cut = cut

    def renew(self) -> None:
        """Stand still, with nothing broken."""
        self.cut = self.base.lossy = self.base.frozen = False
        self.base.works = True
        self.base.grip, self.base.delay = GRIP, 0.0
        self.base.brakes.clear()
        self.base.told = self.base.wheel = 0.0

    def truth(self) -> dict[str, Any]:
        """Tell how things are, past every interface of ROS."""
        return {
            "wheel": self.base.wheel,
            "told": self.base.told,
            "heard": self.base.heard,
            "zeroed": self.base.zeroed,
            "running": self.navigator.running,
            "finished": self.navigator.finished,
            "began": self.navigator.began,
            "brakes": sorted(name for name, on in self.base.brakes.items() if on),
        }

    def peak(self, seconds: float) -> float:
        """Tell how fast the wheels turned at most, in the time that has just passed."""
        since = time.monotonic() - seconds
        return max((abs(wheel) for at, wheel in self.base.history if at >= since), default=-1.0)

    def mean(self, seconds: float) -> float:
        """Tell how fast they turned on average."""
        since = time.monotonic() - seconds
        found = [abs(wheel) for at, wheel in self.base.history if at >= since]
        return sum(found) / len(found)

    def rested(self, since: float) -> float | None:
        """Tell when the wheels came to rest for good, of those times after one; None if they turn."""
        at = None
        for when, wheel in reversed(self.base.history):
            if when < since or wheel:
                break
            at = when
        return at

    def put(self, name: str, *, value: float) -> None:
        """Change what it does: `lossy`, `frozen`, `works`, `grip`, `delay`."""
        setattr(self.base, name, value)


def main() -> None:
    from robot_nodes import serve

    rclpy.init()
    serve(Robot())
    os._exit(0)  # whatever still spins


if __name__ == "__main__":
    main()
