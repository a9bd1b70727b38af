"""The action servers of a robot: their goals from any client, and how these are cancelled.

Everything here runs in the ROS thread, except for the queries.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rcp_ros2.cdr import Codec, Malformed, Value
from rcp_ros2.config import Qos
from rcp_ros2.graph import GOALS
from rcp_ros2.idl import load
from rcp_ros2.link import RosLink
from rcp_ros2.pulse import node_of
from rcp_ros2.ros import one_argument
from rcp_ros2.topics import Tap

__all__ = ["ActionServer"]

_STATUSES = "action_msgs/msg/GoalStatusArray"
_ACTIVE = (1, 2, 3)  # action_msgs/msg/GoalStatus: accepted, executing, canceling
_CANCELING = 3
_UNKNOWN, _TERMINATED = 2, 3  # action_msgs/srv/CancelGoal
_GIVEN_UP = 100  # abandoned goals whose servers may return
_AGAIN = 0.2  # s between two cancels of a continuing goal
_NONE = bytes(16)
"""The id that stands for all goals."""


class ActionServer:
    """One action server."""

    def __init__(
        self,
        link: RosLink,
        name: str,
        robot: str | None,
        on_goals: Callable[[ActionServer], None],
    ) -> None:
        from action_msgs.srv import CancelGoal

        self.name = name
        self.robot = robot
        self.goals: dict[bytes, int] = {}
        """The unfinished goals with their status."""
        self.answered_at = 0.0
        """Monotonic time of the last response to a cancel."""
        self.refused = False
        """Whether it recently refused to cancel a goal."""
        self._link = link
        self._on_goals = on_goals
        """Called when a goal is active that is not being cancelled."""
        self._srv = CancelGoal
        self._client: Any = link.ros.node.create_client(CancelGoal, f"{name}/_action/cancel_goal")
        self._pending: dict[bytes, Any] = {}
        self._requested_at = 0.0
        self._abandoned: set[bytes] = set()
        """Abandoned goals of the gateway, which must not continue."""
        self._servers: frozenset[bytes] = frozenset()
        """The publishers of the current statuses."""
        self._several = False
        """Whether these belong to several nodes, each of which tells of its own goals only."""
        codec = Codec(load(_STATUSES))
        self._tap = Tap(f"stop {name}", codec, taker=self._on_status)
        link.subscriptions.tap(f"{name}{GOALS}", load(_STATUSES), Qos(), self._tap)

    # -- queries, from any thread ----------------------------------------------------------------

    def active(self) -> int:
        """Return the number of unfinished goals."""
        return len(self.goals)

    def trouble(self) -> str:
        """Describe why its goals have not ended."""
        count = len(self.goals)
        goals = "1 goal" if count == 1 else f"{count} goals"
        if self.refused:
            return f"{self.name} refuses to cancel {goals}"
        return f"{goals} of {self.name} still active"

    # -- ROS thread ------------------------------------------------------------------------------

    def cancel(self, goal: bytes = _NONE) -> None:
        """Cancel one goal or all goals; `press` repeats it if that has no effect."""
        self._requested_at = time.monotonic()
        if not self._client.service_is_ready():
            return
        if (old := self._pending.pop(goal, None)) is not None:
            self._client.remove_pending_request(old)
        request = self._srv.Request()
        request.goal_info.goal_id.uuid = list(goal)
        self._pending[goal] = future = self._client.call_async(request)
        future.add_done_callback(one_argument(partial(self._answered, goal)))

    def press(self, now: float, since: float) -> None:
        """Cancel continuing goals again; query servers silent since the stop."""
        if now - self._requested_at < _AGAIN:
            return
        running = [goal for goal, status in self.goals.items() if status != _CANCELING]
        if running:  # one by one: rclpy's server skips some when it refuses others
            for goal in running:
                self.cancel(goal)
        elif self.answered_at < since:
            self.cancel()

    def abandon(self, goal: bytes) -> None:
        """Cancel a goal now, or as soon as its server is back and runs it."""
        if len(self._abandoned) < _GIVEN_UP:
            self._abandoned.add(goal)
        self.cancel(goal)

    def poll(self) -> None:
        """Forget the goals of a lost server; cancel abandoned goals that continue."""
        servers = self._publishers()
        if self._servers and self._servers.isdisjoint(servers):
            self.goals = {}
            self._servers = frozenset()
        self._end_abandoned()

    def _end_abandoned(self) -> None:
        for goal in self._abandoned & self.goals.keys():
            if self.goals[goal] != _CANCELING:
                self.cancel(goal)

    def _answered(self, goal: bytes, future: Any) -> None:
        if self._pending.get(goal) is future:
            del self._pending[goal]
        response = future.result()
        self.answered_at = time.monotonic()
        if goal not in self.goals:
            return
        if response.return_code in (_UNKNOWN, _TERMINATED):
            if not self._several:
                del self.goals[goal]  # a restarted server does not know it
        elif goal not in {bytes(info.goal_id.uuid) for info in response.goals_canceling}:
            self.refused = self.goals[goal] != _CANCELING

    def _on_status(self, value: Value) -> None:
        try:
            statuses = value.decode().status_list
        except Malformed:
            return
        found = {bytes(one.goal_info.goal_id.uuid): one.status for one in statuses}
        self._servers = self._publishers()
        known = {**self.goals, **found} if self._several else found
        self.goals = {goal: status for goal, status in known.items() if status in _ACTIVE}
        self._abandoned -= found.keys() - self.goals.keys()
        if not self.goals:
            self.refused = False
        self._end_abandoned()
        if any(status != _CANCELING for status in self.goals.values()):
            self._on_goals(self)

    def _publishers(self) -> frozenset[bytes]:
        infos = self._link.ros.node.get_publishers_info_by_topic(f"{self.name}{GOALS}")
        # A node that was restarted has its name twice, until the graph has noticed.
        self._several = len({node_of(info) for info in infos} - {None}) > 1
        return frozenset(bytes(info.endpoint_gid) for info in infos)

    def close(self) -> None:
        """Release its ROS entities."""
        self._link.subscriptions.untap(f"{self.name}{GOALS}", self._tap.name)
        self._link.ros.node.destroy_client(self._client)
