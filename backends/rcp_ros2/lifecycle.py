"""Lifecycle nodes: their state as a sensor, their transitions as a service."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import msgspec

from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    DeviceTimeout,
    EstopActive,
    RcpError,
)
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress, check_fence
from rcp_ros2.binding import Binding, Offer, Shared, common
from rcp_ros2.caller import Caller
from rcp_ros2.cdr import Codec, Value
from rcp_ros2.config import Mapping, Qos
from rcp_ros2.graph import Graph
from rcp_ros2.idl import load
from rcp_ros2.topics import Tap

__all__ = ["Lifecycles"]

_MARGIN = 1.0  # s that the gateway waits longer than the node may take
_ANSWER = 1.0  # s for a response, before the request is repeated
_MISSES = 3  # polls without a response, after which the last state counts as stale

State = Literal[
    "unknown",
    "unconfigured",
    "inactive",
    "active",
    "finalized",
    "configuring",
    "cleaningup",
    "shuttingdown",
    "activating",
    "deactivating",
    "errorprocessing",
]
Transition = Literal["configure", "cleanup", "activate", "deactivate", "shutdown"]

# lifecycle_msgs/msg/Transition; shutdown has a different number in each state.
_POSSIBLE: dict[str, dict[Transition, int]] = {
    "unconfigured": {"configure": 1, "shutdown": 5},
    "inactive": {"cleanup": 2, "activate": 3, "shutdown": 6},
    "active": {"deactivate": 4, "shutdown": 7},
}
_ENERGISING = ("configure", "activate")
"""Transitions that may apply torque to motors, or start to move them."""
_GOALS: dict[Transition, State] = {
    "configure": "inactive",
    "cleanup": "unconfigured",
    "activate": "active",
    "deactivate": "inactive",
    "shutdown": "finalized",
}


class LifecycleState(msgspec.Struct, frozen=True):
    """The state of a lifecycle node and the transitions possible from it."""

    state: State
    transitions: list[Transition]


class LifecycleChange(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A transition of a lifecycle node."""

    transition: Transition


def _state(label: str) -> LifecycleState:
    known: Any = label if label in State.__args__ else "unknown"
    return LifecycleState(known, list(_POSSIBLE.get(label, ())))


class Lifecycles:
    """Finds the exposed lifecycle nodes."""

    def __init__(self, shared: Shared, exposes: Callable[[str], bool]) -> None:
        self._shared = shared
        self._exposes = exposes

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return a sensor and a service for each node."""
        found: dict[str, Offer] = {}
        for node in filter(self._exposes, graph.lifecycle):
            for kind, made in (("sensor", StateOf), ("service", ChangeOf)):
                name = self._shared.naming.path(kind, node, before=("lifecycle",))
                mapping = Mapping(service=f"{node}/change_state")
                found[name] = Offer(mapping, partial(made, self._shared, name, node, mapping))
        return found


class _Question:
    """Requests the state of a node."""

    def __init__(self, shared: Shared, node: str) -> None:
        srv = load("lifecycle_msgs/srv/GetState")
        self._request = srv.Request
        self._caller = Caller(
            shared,
            srv,
            f"{node}/get_state",
            presence=("lifecycle node", node),
            convert=lambda response: _state(response.current_state.label),
        )
        self.close = self._caller.close

    async def get_state(self, limit: float) -> LifecycleState:
        """Return the state; a request that is lost during discovery is repeated.

        :raises AdapterUnavailable: the node is not running.
        :raises DeviceTimeout: it does not respond, as many nodes during a transition.
        """
        end = time.monotonic() + limit
        while (left := end - time.monotonic()) > _ANSWER:
            with contextlib.suppress(DeviceTimeout):
                return await self._caller.call(self._request(), _ANSWER)
        return await self._caller.call(self._request(), max(left, _ANSWER / 2))


class StateOf(Binding):
    """The state of a lifecycle node: polled, and updated by the node's transition events.

    While subscribed, the node is polled with the graph, because a restarted node publishes nothing;
    the state of a dead node goes stale.
    """

    def __init__(self, shared: Shared, name: str, node: str, mapping: Mapping) -> None:
        self._question = _Question(shared, node)
        self._event = load("lifecycle_msgs/msg/TransitionEvent")
        self._codec = Codec(self._event)
        self._topic = f"{node}/transition_event"
        self._query: asyncio.Task[None] | None = None
        facts = common(name, mapping, f"State of the lifecycle node {node}.", node=node)
        facts["timeout"] = shared.config.timeout + _MARGIN
        facts["deadline"] = _MISSES * shared.config.poll + _MARGIN
        super().__init__(shared, Resource(value=LifecycleState, **facts), mapping)

    async def read(self) -> Any:
        """Read the state from the node."""
        return await self._question.get_state(self.timeout)

    def watched(self, rate: float) -> None:
        """Publish the state and each change of it."""
        if self._query is None:
            tap = Tap(self.resource.name, self._codec, taker=self._on_transition)
            self.shared.ros.post(
                self.shared.subscriptions.tap, self._topic, self._event, Qos(), tap
            )
            self._query = asyncio.ensure_future(self._query_state())

    def unwatched(self) -> None:
        """Stop publishing."""
        if self._query is not None:
            self._query.cancel()
            self._query = None
            self.shared.ros.post(self.shared.subscriptions.untap, self._topic, self.resource.name)

    async def _query_state(self) -> None:
        while True:
            with contextlib.suppress(RcpError):  # the state goes stale
                self._publish(await self.read())
            await asyncio.sleep(self.shared.config.poll)

    def _on_transition(self, event: Value) -> None:
        label = event.decode().goal_state.label
        self.shared.host.call_soon(self._publish, _state(label))

    def _publish(self, state: LifecycleState) -> None:
        if self._query is not None:
            self.shared.host.publish(self.resource.name, state)

    def close(self) -> None:
        """Stop publishing, and destroy the client."""
        self.unwatched()
        self._question.close()


class ChangeOf(Binding):
    """The transitions of a lifecycle node."""

    def __init__(self, shared: Shared, name: str, node: str, mapping: Mapping) -> None:
        self._node = node
        self._question = _Question(shared, node)
        self._srv = load("lifecycle_msgs/srv/ChangeState")
        self._transition = load("lifecycle_msgs/msg/Transition")
        presence = ("lifecycle node", node)
        self._caller = Caller(shared, self._srv, mapping.target, presence=presence)
        self._energising = Caller(
            shared, self._srv, mapping.target, presence=presence, admit=self._admit
        )
        facts = common(
            name,
            mapping,
            f"Change the state of the lifecycle node {node}, and return the resulting state.",
            node=node,
        )
        facts["timeout"] = shared.config.transition_timeout + shared.config.timeout + _MARGIN
        facts["policy"] = "reject"  # one transition at a time, as in the node itself
        resource = Resource(
            input=LifecycleChange,
            output=LifecycleState,
            examples=({"transition": "activate"},),
            **facts,
        )
        super().__init__(shared, resource, mapping)

    def _admit(self) -> None:
        """Check a transition that energises; others must stay possible during an e-stop."""
        check_fence()
        self.shared.keeper.admit(self.resource.robot)

    async def execute(self, value: Any, progress: Progress) -> LifecycleState:
        """Run a transition of the node.

        :raises EstopActive: it would energise a stopped robot; transitions towards shutdown are
            allowed.
        :raises DeviceRejected: it is not possible from the current state, or it failed in the node.
        """
        transition: Transition = value.transition
        energises = transition in _ENERGISING
        if energises and self.shared.host.is_latched(self.resource.robot):
            raise EstopActive(
                f"an e-stop is latched: {self._node} is not allowed to {transition}",
                remedy="Reset the e-stop first; `deactivate`, `cleanup` and `shutdown` are allowed.",
            )
        before = (await self._question.get_state(self.timeout)).state
        possible = _POSSIBLE.get(before, {})
        if transition not in possible:
            raise self._impossible(transition, before)
        request = self._srv.Request(transition=self._transition(id=possible[transition]))
        caller = self._energising if energises else self._caller
        response = await caller.call(request, self.shared.config.transition_timeout)
        after = await self._after(transition, succeeded=response.success)
        if not response.success:
            progress()  # the node has tried
            raise DeviceRejected(
                f"{self._node} failed to {transition}: it was {before} and is now {after.state}",
                remedy="See the node's log for the reason.",
                details={"before": before, "state": after.state, "transitions": after.transitions},
            )
        return after

    def _impossible(self, transition: Transition, state: State) -> DeviceRejected:
        possible = list(_POSSIBLE.get(state, ()))
        return DeviceRejected(
            f"{self._node} is {state} and cannot {transition} from this state",
            remedy=f"From {state} it can {' or '.join(possible)}."
            if possible
            else f"Wait until it has left the state {state}, or restart the node.",
            details={"state": state, "transitions": possible},
        )

    async def _after(self, transition: Transition, *, succeeded: bool) -> LifecycleState:
        try:
            return await self._question.get_state(self.timeout)
        except (AdapterUnavailable, DeviceTimeout):
            # Many nodes exit after their shutdown.
            return _state(_GOALS[transition] if succeeded else "unknown")

    def close(self) -> None:
        """Destroy the clients."""
        self._question.close()
        self._caller.close()
        self._energising.close()
