"""The goals of an action, from any client, as its server reports them, and their cancellation."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from collections.abc import Set as AbstractSet
from functools import partial
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, InvalidValue
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_ros2.binding import Binding, Offer, Shared, common
from rcp_ros2.caller import Caller
from rcp_ros2.cdr import Codec
from rcp_ros2.config import Mapping
from rcp_ros2.graph import GOALS, Graph
from rcp_ros2.idl import load
from rcp_ros2.sensors import Observed

__all__ = ["Goals", "goals_of"]

_TYPE = "action_msgs/msg/GoalStatusArray"
_LATCHED = 1.0  # s
_REST = 4.0  # s for a cancelled goal to come to rest
_PAUSE = 0.05  # s between two looks at the goals
_UNFINISHED = ("accepted", "executing", "canceling")
_REFUSED, _NOT_KNOWN, _TERMINATED = 1, 2, 3  # action_msgs/srv/CancelGoal

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


class Cancel(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which goals to cancel."""

    id: Annotated[str, Meta(pattern="^[0-9a-f]{32}$")] | None = None
    """As in the sensor of the goals; None cancels all of them, whoever sent them."""


class Cancelled(msgspec.Struct, frozen=True):
    """The goals that were cancelled and have ended."""

    ids: list[str]


class Goals:
    """Provides the goals of each exposed action."""

    def __init__(self, shared: Shared, actions: AbstractSet[str]) -> None:
        self._shared = shared
        self._actions = actions
        """A live set, maintained by the catalog."""

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return a sensor for each action, and a service that cancels its goals."""
        found: dict[str, Offer] = {}
        for action in self._actions:
            mapping = Mapping(action=action)
            name = self._shared.naming.path("sensor", action, before=("goals",))
            goals = partial(goals_of, self._shared, name, mapping)
            found[name] = Offer(mapping, goals)
            # Not a mapping of the action: a stop cancels the goals of those that move the robot.
            cancel = Mapping(service=f"{action}/_action/cancel_goal")
            name = self._shared.naming.path("service", action, before=("cancel",))
            found[name] = Offer(cancel, partial(_canceller, self._shared, name, cancel, goals))
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

    async def measured(self) -> tuple[Any, int | None]:
        """Return the goals.

        :raises AdapterUnavailable: no node serves the action.
        """
        try:
            return await super().measured()
        except DeviceTimeout:
            return [], None


def _canceller(
    shared: Shared, name: str, mapping: Mapping, goals: Callable[[], Binding]
) -> Binding:
    return _Canceller(shared, name, mapping, goals())


class _Canceller(Binding):
    """Cancels goals of an action, whoever sent them."""

    def __init__(self, shared: Shared, name: str, mapping: Mapping, goals: Binding) -> None:
        self._action = action = mapping.target.removesuffix("/_action/cancel_goal")
        text = f"Cancels goals of action {action}, those of other clients too."
        facts = common(name, mapping, text, action=action)
        facts["moves"] = False
        facts["timeout"] = shared.config.timeout + _REST
        resource = Resource(input=Cancel, output=Cancelled, **facts)
        self._srv = load("action_msgs/srv/CancelGoal", "srv")
        presence = ("action", action)
        self._caller = Caller(shared, self._srv, mapping.target, presence=presence)
        self._goals = goals
        super().__init__(shared, resource, mapping)

    async def execute(self, value: Any, progress: Progress) -> Cancelled:
        """Cancel goals, and wait until they have ended.

        :raises InvalidValue: there is no such goal.
        :raises DeviceRejected: the server refuses to cancel, or the goal has ended by itself.
        :raises DeviceTimeout: a goal has not ended in time.
        """
        one = None if value is None else value.id
        request = self._srv.Request()
        if one is not None:
            request.goal_info.goal_id.uuid = list(bytes.fromhex(one))
        answer = await self._caller.call(request, self.timeout)
        if one is not None and answer.return_code == _NOT_KNOWN:
            raise InvalidValue(
                f"{self._action} has no goal {one}",
                details={"pointer": "/id"},
                remedy="Read the ids of its goals from the sensor of the goals.",
            )
        if answer.return_code == _TERMINATED:
            raise DeviceRejected(f"the goal {one} has already ended")
        running = one is not None or await self._running()
        if answer.return_code == _REFUSED or (running and not answer.goals_canceling):
            raise DeviceRejected(
                f"the server of {self._action} refuses to cancel; the goal continues",
                remedy="Use the e-stop if the robot must stop.",
            )
        goals = {bytes(goal.goal_id.uuid).hex() for goal in answer.goals_canceling}
        await self._ended(goals)
        return Cancelled(sorted(goals))

    async def _running(self) -> set[str]:
        return {goal.id for goal in await self._goals.read() if goal.status in _UNFINISHED}

    async def _ended(self, goals: set[str]) -> None:
        end = time.monotonic() + _REST
        while not goals.isdisjoint(await self._running()):
            if time.monotonic() >= end:
                raise DeviceTimeout(
                    f"the cancel of {self._action} was accepted, but its goal has not ended yet",
                    remedy="Check the robot: it may still be moving. Use the e-stop if in doubt.",
                )
            await asyncio.sleep(_PAUSE)

    def close(self) -> None:
        """Destroy the client."""
        self._caller.close()
