"""The goals of an action, from any client, as its server reports them."""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from functools import partial
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.errors import DeviceTimeout
from rcp_kernel.model import Resource
from rcp_ros2.binding import Binding, Offer, Shared, common
from rcp_ros2.cdr import Codec
from rcp_ros2.config import Mapping
from rcp_ros2.graph import GOALS, Graph
from rcp_ros2.idl import load
from rcp_ros2.sensors import Observed

__all__ = ["Goals", "goals_of"]

_TYPE = "action_msgs/msg/GoalStatusArray"
_LATCHED = 1.0  # s

Status = Literal[
    "unknown", "accepted", "executing", "canceling", "succeeded", "canceled", "aborted"
]
_STATUSES: tuple[Status, ...] = Status.__args__
"""Status by number in action_msgs/msg/GoalStatus."""


class GoalState(msgspec.Struct, frozen=True):
    """One goal: sender, time of acceptance and status."""

    id: str
    sender: Literal["gateway", "other"]
    accepted: Annotated[float, Meta(extra_json_schema={"unit": "s"})]
    status: Status


class _Statuses(Codec):
    """Decodes action_msgs/msg/GoalStatusArray."""

    def __init__(self, shared: Shared) -> None:
        super().__init__(load(_TYPE))
        self.type = list[GoalState]
        self._shared = shared

    def decode(self, data: bytes) -> list[GoalState]:
        """Return the goals, newest first."""
        found = [self._state(one) for one in super().decode(data).status_list]
        return sorted(found, key=lambda goal: -goal.accepted)

    def _state(self, one: Any) -> GoalState:
        id_, stamp = bytes(one.goal_info.goal_id.uuid), one.goal_info.stamp
        status = _STATUSES[one.status] if 0 <= one.status < len(_STATUSES) else "unknown"
        sender = "gateway" if id_ in self._shared.sent_goals else "other"
        return GoalState(id_.hex(), sender, stamp.sec + stamp.nanosec / 1e9, status)


class Goals:
    """Provides the goals of each exposed action."""

    def __init__(self, shared: Shared, actions: AbstractSet[str]) -> None:
        self._shared = shared
        self._actions = actions
        """A live set, maintained by the catalog."""

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return a sensor for each action."""
        found: dict[str, Offer] = {}
        for action in self._actions:
            name = self._shared.naming.path("sensor", action, before=("goals",))
            mapping = Mapping(action=action)
            found[name] = Offer(mapping, partial(goals_of, self._shared, name, mapping))
        return found


def goals_of(shared: Shared, name: str, mapping: Mapping) -> Binding:
    """Create the sensor of an action's goals; called in the ROS thread."""
    action = mapping.target
    text = f"Goals of action {action} from any client, newest first."
    facts = common(name, mapping, text, action=action)
    codec = _Statuses(shared)
    resource = Resource(value=codec.type, native=_TYPE, **facts)
    status = msgspec.structs.replace(mapping, action=None, topic=f"{action}{GOALS}")
    return _Goals(shared, resource, status, load(_TYPE), codec)


class _Goals(Observed):
    """The goals; an action server without goals so far publishes nothing."""

    @property
    def timeout(self) -> float:
        """Time-out in s for the latched message."""
        return _LATCHED

    async def read(self) -> Any:
        """Return the goals.

        :raises AdapterUnavailable: no node serves the action.
        """
        try:
            return await super().read()
        except DeviceTimeout:
            return []
