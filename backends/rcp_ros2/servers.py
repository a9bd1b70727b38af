"""The action servers of a robot: their goals from any client, and how these are cancelled.

Everything here runs in the ROS thread, except for the queries.
"""

from __future__ import annotations

import math
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
_REJECTED = 10.0  # s within which a goal that one server rejected is expected at another one
_LEASE = 20.0  # s for which the graph lists a killed node: the lease of Fast DDS
_HEARD = 1.0  # s for the servers that are left to repeat what they have said
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
        self.answered_at = -math.inf
        """Monotonic time of the last response to a cancel; -inf before the first."""
        self.refused = False
        """Whether it recently refused to cancel a goal."""
        self._link = link
        self._on_goals = on_goals
        """Called when a goal is active that is not being cancelled."""
        self._srv = CancelGoal
        self._client: Any = link.ros.node.create_client(CancelGoal, f"{name}/_action/cancel_goal")
        self._pending: dict[bytes, Any] = {}
        self._requested_at = -math.inf
        self._abandoned: dict[bytes, float] = {}
        """Abandoned goals of the gateway, which must not continue, and until when they are remembered."""
        self._servers: dict[bytes, float] = {}
        """The publishers of the statuses, each of which tells of its own goals only, and since when."""
        self._several = False
        """Whether more than one of them is known to live; a killed one stays in the graph for a while."""
        self._unknown: set[bytes] = set()
        """Goals that one of several servers did not know."""
        self._twins: set[bytes] = set()
        """Servers of one name that were found to live at the same time."""
        self._doubtful: set[bytes] = set()
        """Goals that may have been those of a server that has left the graph."""
        self._doubtful_until = 0.0
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

    def abandon(self, goal: bytes, *, rejected: bool = False) -> None:
        """Cancel a goal now, or as soon as its server is back and runs it.

        One that was `rejected` by a server either runs at another one soon, or never.
        """
        until = time.monotonic() + _REJECTED if rejected else math.inf
        self._abandoned[goal] = max(until, self._abandoned.pop(goal, until))
        if len(self._abandoned) > _GIVEN_UP:  # the one that matters least, or else the oldest
            del self._abandoned[min(self._abandoned, key=self._abandoned.__getitem__)]
        self.cancel(goal)

    def poll(self) -> None:
        """Forget the goals of a lost server; cancel abandoned goals that continue."""
        self._look_for_servers()
        now = time.monotonic()
        if self._doubtful and not self._doubtful_until:
            self._doubtful_until = now + _HEARD
            self._link.subscriptions.renew(f"{self.name}{GOALS}")
        elif self._doubtful and now >= self._doubtful_until:
            self.goals = {g: status for g, status in self.goals.items() if g not in self._doubtful}
            self._doubtful.clear()
        for goal in [g for g, until in self._abandoned.items() if until < now]:
            if goal not in self.goals:
                del self._abandoned[goal]
        self._end_abandoned()

    def _end_abandoned(self) -> None:
        for goal in self._abandoned.keys() & self.goals.keys():
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
                if len(self._servers) > 1:
                    self._unknown.add(goal)
        elif goal not in {bytes(info.goal_id.uuid) for info in response.goals_canceling}:
            self.refused = self.goals[goal] != _CANCELING

    def _on_status(self, value: Value) -> None:
        try:
            statuses = value.decode().status_list
        except Malformed:
            return
        found = {bytes(one.goal_info.goal_id.uuid): one.status for one in statuses}
        self._look_for_servers()
        active = {goal for goal, status in found.items() if status in _ACTIVE}
        if not self._unknown.isdisjoint(active):  # who did not know it is not the one that runs it
            self._twins, self._several = set(self._servers), True
            self._unknown.clear()
        self._doubtful -= found.keys()
        known = {**self.goals, **found} if len(self._servers) > 1 else found
        self.goals = {goal: status for goal, status in known.items() if status in _ACTIVE}
        for goal in found.keys() - active:
            self._abandoned.pop(goal, None)
        if not self.goals:
            self.refused = False
        self._end_abandoned()
        if any(status != _CANCELING for status in self.goals.values()):
            self._on_goals(self)

    def _look_for_servers(self) -> None:
        infos = self._link.ros.node.get_publishers_info_by_topic(f"{self.name}{GOALS}")
        now = time.monotonic()
        here = {bytes(info.endpoint_gid) for info in infos}
        if self._servers and self._servers.keys().isdisjoint(here):
            self.goals = {}
        elif self._servers.keys() - here:  # no status tells whose it is
            self._doubtful |= self.goals.keys()
            self._doubtful_until = 0.0
        self._servers = {gid: self._servers.get(gid, now) for gid in here}
        if len(here) < 2:
            self._unknown.clear()
        self._twins = self._twins if self._twins <= here else set()
        # One that was restarted is there twice under its name, until the lease of the first ends.
        lasting = sum(now - since > _LEASE for since in self._servers.values())
        names = {node_of(info) for info in infos} - {None}
        self._several = len(names) > 1 or lasting > 1 or bool(self._twins)

    def close(self) -> None:
        """Release its ROS entities."""
        self._link.subscriptions.untap(f"{self.name}{GOALS}", self._tap.name)
        self._link.ros.node.destroy_client(self._client)
