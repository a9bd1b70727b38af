"""Offer an arm of the gateway to MoveIt, or another client of FollowJointTrajectory on a ROS 2 graph.

python examples/moveit_arm.py --arm /tenant/cell --ros /tenant/graph --name /arm_controller/follow_joint_trajectory

The gateway has the arm (a joint group on CAN, or any other with the profile `arm`), and a ROS 2 backend with
`offers = true` and `map = {"actuator/joint_states" = {topic = "/joint_states", type = "sensor_msgs/msg/JointState",
moves = false, valid_for = 0, require_subscriber = false}}`. Each goal becomes `action/follow_trajectory`, so rights, limits,
leases and stops of the gateway hold. The states of the joints go to the graph.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from typing import Any

import rcp_client
from rcp_kernel.errors import DeviceRejected, RcpError

INVALID_GOAL, PATH_TOLERANCE_VIOLATED = -1, -4
STILL = 1e-6  # rad/s of the last point that counts as rest


def trajectory(goal: dict[str, Any]) -> dict[str, Any]:
    """Return the input of `action/follow_trajectory` for a goal."""
    names = goal["trajectory"]["joint_names"]
    points: list[dict[str, Any]] = []
    for point in goal["trajectory"]["points"]:
        at = point["time_from_start"]
        made = {
            "time": at["sec"] + at["nanosec"] / 1e9,
            "positions": dict(zip(names, point["positions"], strict=True)),
        }
        if point["velocities"]:
            made["velocities"] = dict(zip(names, point["velocities"], strict=True))
        points.append(made)
    if points and all(abs(speed) < STILL for speed in points[-1].get("velocities", {}).values()):
        points[-1].pop("velocities", None)  # it ends at rest in any case
    return {"points": points}


class Bridge:
    """Serves goals of the graph, and tells it where the joints are."""

    def __init__(self, client: rcp_client.Client, arm: str, ros: str) -> None:
        self._client = client
        self._arm, self._ros = arm.rstrip("/"), ros.rstrip("/")
        self._begun: dict[str, rcp_client.CommandHandle | None] = {}
        """The command of each goal; None before it has one."""
        self._cancelled: set[str] = set()
        self._tasks: set[asyncio.Task[None]] = set()

    def path(self, branch: str, name: str) -> str:
        """Return the path of a resource of the arm; `/tenant/cell/left` is one of several."""
        _, tenant, name_of_tenant, *place = self._arm.split("/")
        return "/".join(["", tenant, name_of_tenant, branch, *place, name])

    async def serve(self, name: str) -> None:
        """Offer the action until cancelled, and end the goals with it."""
        offer = {
            "name": name,
            "kind": "action",
            "type": "control_msgs/action/FollowJointTrajectory",
            "description": "Moves the joints of an arm of the gateway along a trajectory.",
        }
        try:
            await self._client.execute(
                f"{self._ros}/action/ros/offer", offer, on_feedback=self._look
            )
        finally:
            for handle in self._begun.values():
                if handle is not None:
                    handle.cancel_soon()

    async def tell(self) -> None:
        """Send the states of the joints to the graph, as they come."""
        path = f"{self._ros}/actuator/joint_states"
        async with self._client.subscribe(self.path("sensor", "joint_states"), rate=50) as updates:
            async for update in updates:
                states = update.body
                message = {key: states.get(key) or [] for key in ("name", "position", "velocity")}
                try:
                    await self._client.write(path, {"header": {}, **message})
                except RcpError as error:  # no reason to end a goal under way
                    print(f"{path}: {error.message}", file=sys.stderr)

    def _look(self, feedback: rcp_client.Feedback) -> None:
        """Begin with new goals, and cancel those that are to be."""
        waiting = feedback.body or {}
        for call in waiting.get("calls", ()):
            if call not in self._begun:
                self._begun[call] = None
                task = asyncio.ensure_future(self._follow(call))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)
        for call in waiting.get("cancelled", ()):
            if call not in self._cancelled:
                self._cancelled.add(call)
                if (handle := self._begun.get(call)) is not None:
                    handle.cancel_soon()

    async def _follow(self, call: str) -> None:
        """Carry out one goal; it ends when the arm has ended, at rest."""
        answer: dict[str, Any]
        try:
            taken = await self._client.execute(f"{self._ros}/service/ros/take", {"call": call})
            answer = await self._moved(call, taken["input"])
        except RcpError as error:
            code = PATH_TOLERANCE_VIOLATED if isinstance(error, DeviceRejected) else INVALID_GOAL
            result = {"error_code": code, "error_string": error.message}
            answer = {"error": error.message, "output": result}
            if call in self._cancelled and error.code == "cancelled":
                answer = {"cancelled": True}
        except (KeyError, TypeError, ValueError) as wrong:
            result = {"error_code": INVALID_GOAL, "error_string": str(wrong)}
            answer = {"error": f"not a trajectory: {wrong}", "output": result}
        finally:
            self._begun.pop(call, None)
        await self._respond(call, answer)
        self._cancelled.discard(call)

    async def _moved(self, call: str, goal: dict[str, Any]) -> dict[str, Any]:
        handle = await self._client.start(
            self.path("action", "follow_trajectory"), trajectory(goal)
        )
        self._begun[call] = handle
        if call in self._cancelled:
            handle.cancel_soon()
        await handle.result()
        return {"output": {"error_code": 0, "error_string": ""}}

    async def _respond(self, call: str, answer: dict[str, Any]) -> None:
        try:
            await self._client.execute(f"{self._ros}/service/ros/respond", {"call": call, **answer})
        except RcpError as error:  # its client has gone
            print(f"{call}: {error.message}", file=sys.stderr)


async def main(args: argparse.Namespace) -> None:
    """Connect, and serve until it is interrupted."""
    async with rcp_client.connect(args.url, token=args.token) as client:
        bridge = Bridge(client, args.arm, args.ros)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(bridge.serve(args.name))
            tasks.create_task(bridge.tell())


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--url", help="the gateway (default: RCP_URL, or this machine)")
    parser.add_argument("--token", help="a key that may command (default: RCP_TOKEN)")
    parser.add_argument("--arm", required=True, help="path of the arm")
    parser.add_argument("--ros", required=True, help="path of the tenant of the ROS 2 backend")
    parser.add_argument(
        "--name", default="/arm_controller/follow_joint_trajectory", help="of the action"
    )
    return parser.parse_args()


if __name__ == "__main__":
    try:
        asyncio.run(main(arguments()))
    except KeyboardInterrupt:
        sys.exit(130)
