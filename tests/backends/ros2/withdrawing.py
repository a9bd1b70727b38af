"""Offers of actions that are withdrawn while requests arrive for them, in a process of its own.

Run as `python withdrawing.py DOMAIN ROUNDS`; it says `whole` at the end, unless the process ended.
"""

from __future__ import annotations

import asyncio
import sys
import threading
import time
from typing import Any

import rclpy
from action_msgs.srv import CancelGoal
from rclpy.context import Context

from backends.ros2.robot import BOUND, Robot, robot_of

_OFFERS = 8
_PAUSE = 0.0005  # s between two requests of each


class Requests:
    """A client on the graph that keeps asking the servers of actions to cancel all goals."""

    def __init__(self, domain: int, names: list[str]) -> None:
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node(
            "asker", context=self._context, start_parameter_services=False, enable_rosout=False
        )
        self._clients: list[Any] = [
            self._node.create_client(CancelGoal, f"{name}/_action/cancel_goal") for name in names
        ]
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._ask)

    async def until(self, *, ready: bool) -> None:
        """Wait until all of the servers are there, or none."""
        async with asyncio.timeout(BOUND):
            while any(one.service_is_ready() != ready for one in self._clients):  # noqa: ASYNC110
                await asyncio.sleep(0.01)

    def start(self) -> None:
        self._thread.start()

    def _ask(self) -> None:
        while not self._over.is_set():
            for client in self._clients:
                client.remove_pending_request(client.call_async(CancelGoal.Request()))
            time.sleep(_PAUSE)

    def leave(self) -> None:
        """End, and leave the graph."""
        self._over.set()
        self._thread.join()
        self._node.destroy_node()
        self._context.try_shutdown()


async def offered(robot: Robot, domain: int, turn: int) -> None:
    """Offer actions, and withdraw them while requests arrive."""
    names = [f"/turn_{turn}/offer_{number}" for number in range(_OFFERS)]
    facts = {"kind": "action", "type": "test_msgs/action/Fibonacci"}
    offers = [
        asyncio.create_task(robot.execute("action/ros/offer", {"name": name, **facts}))
        for name in names
    ]
    requests = Requests(domain, names)
    await requests.until(ready=True)
    requests.start()
    if turn % 2:  # the client leaves first
        await asyncio.sleep(0.05)
        requests.leave()
    for offer in offers:
        offer.cancel()
    await asyncio.gather(*offers, return_exceptions=True)
    if not turn % 2:
        await requests.until(ready=False)
        requests.leave()


async def main(domain: int, turns: int) -> None:
    async with robot_of(domain, offers=True, grace=0.5) as robot:
        for turn in range(turns):
            await offered(robot, domain, turn)
    sys.stdout.write("whole")


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), int(sys.argv[2])))
