"""Polls the graph once per second, in the ROS thread.

rclpy does not report changes. A killed node stays in the graph until the middleware drops it (20 s
with Fast DDS), so being listed does not prove that a node is alive.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from rcp_ros2.pulse import node_of
from rcp_ros2.ros import Ros, contained

__all__ = ["CALLS", "GOALS", "Graph", "GraphWatch"]

_FAST = 0.1  # s between two polls while the graph is being discovered
CALLS = "/_service_event"
"""Suffix of the topic with a service's call events."""
GOALS = "/_action/status"
"""Suffix of the topic with an action's goal statuses."""
_SEND_GOAL = "/_action/send_goal"
_LIST = "/list_parameters"
_CHANGE = "/change_state"
_CHANGES = "lifecycle_msgs/srv/ChangeState"


@dataclass(frozen=True, slots=True)
class Graph:
    """One poll of the graph."""

    topics: dict[str, str] = field(default_factory=dict[str, str])
    """Every topic with its type."""
    services: dict[str, str] = field(default_factory=dict[str, str])
    """The relevant services that have a server."""
    actions: dict[str, str] = field(default_factory=dict[str, str])
    servers: frozenset[str] = frozenset()
    """Every action with a server, relevant or not: a stop cancels its goals."""
    nodes: frozenset[str] = frozenset()
    """Nodes with parameters."""
    lifecycle: frozenset[str] = frozenset()
    """Lifecycle nodes."""
    publishers: dict[str, int] = field(default_factory=dict[str, int])
    """Number of publishers of other nodes on the relevant topics."""
    subscribers: dict[str, int] = field(default_factory=dict[str, int])
    disputed: dict[str, str] = field(default_factory=dict[str, str])
    """Topics that are published with several types, with a description."""

    def has(self, noun: str, name: str) -> bool:
        """Return whether the graph has a topic, service, action or node of this name."""
        match noun:
            case "topic":
                return bool(self.publishers.get(name) or self.subscribers.get(name))
            case "service":
                return name in self.services
            case "action":
                return name in self.actions
            case "lifecycle node":
                return name in self.lifecycle
            case _:
                return name in self.nodes


def _owner(service: str) -> str:
    """Return the action or node of an internal topic or service; others unchanged."""
    for ending in (_SEND_GOAL, GOALS, CALLS, _LIST, _CHANGE):
        service = service.removesuffix(ending)
    return service


class GraphWatch:
    """Polls the graph and notifies the event loop."""

    def __init__(
        self, ros: Ros, matters: Callable[[str], bool], on_change: Callable[[Graph], None]
    ) -> None:
        self._ros = ros
        self._matters = matters
        self._on_change = on_change
        self._next = 0.0
        self._settled = 0.0
        self._chosen: dict[str, str] = {}
        """The chosen type of each topic that has had several."""
        self.on_poll: list[Callable[[], None]] = []
        """Called in the ROS thread at each poll."""

    def start(self) -> None:
        """Start polling; called in the ROS thread."""
        self._settled = time.monotonic() + self._ros.config.grace
        self._ros.node.create_timer(_FAST, contained(self._tick))

    def _tick(self) -> None:
        now = time.monotonic()
        if now < self._next:
            return
        settled = now > self._settled
        self._next = now + (self._ros.config.poll - _FAST / 2 if settled else 0.0)
        for poll in self.on_poll:
            contained(poll)()  # one failing poll must not stop the others
        self._ros.host.call_soon(self._on_change, self._snapshot())

    def _snapshot(self) -> Graph:
        node: Any = self._ros.node
        found = dict(node.get_topic_names_and_types())
        topics = {name: types[0] for name, types in found.items()}
        disputed: dict[str, str] = {}
        for name, types in found.items():
            if len(types) > 1 and self._matters(name):
                topics[name] = self._choose(name, types, disputed)
        offered = node.get_service_names_and_types()
        servers = frozenset(
            name.removesuffix(_SEND_GOAL)
            for name, _ in offered
            if name.endswith(_SEND_GOAL) and node.count_services(name)
        )
        services = {
            name: types[0] if len(types) == 1 else self._served(name, types)
            for name, types in offered
            if (self._matters(name) or self._matters(_owner(name)))
            and node.count_services(name)  # clients list it too
        }
        own_publishers = {p.topic_name for p in node.publishers}
        own_subscriptions = {s.topic_name for s in node.subscriptions}
        publishers: dict[str, int] = {}
        subscribers: dict[str, int] = {}
        for name in topics:
            if self._matters(name) or self._matters(_owner(name)):
                publishers[name] = node.count_publishers(name) - (name in own_publishers)
                subscribers[name] = node.count_subscribers(name) - (name in own_subscriptions)
                # An endpoint of the gateway that was just recreated is briefly listed twice.
                own = name in own_subscriptions
                if subscribers[name] and (own or not publishers[name]):
                    subscribers[name] = self._strangers(name)
        actions = {
            name.removesuffix(_SEND_GOAL): type_.removesuffix("_SendGoal")
            for name, type_ in services.items()
            if name.endswith(_SEND_GOAL)
        }
        nodes = frozenset(n.removesuffix(_LIST) for n in services if n.endswith(_LIST))
        lifecycle = frozenset(
            name.removesuffix(_CHANGE) for name, type_ in services.items() if type_ == _CHANGES
        )
        return Graph(
            topics, services, actions, servers, nodes, lifecycle, publishers, subscribers, disputed
        )

    def _served(self, name: str, types: list[str]) -> str:
        """Return the type that a server has: clients, also those of the gateway, list their own too."""
        node: Any = self._ros.node
        for owner, place in node.get_node_names_and_namespaces():
            with suppress(Exception):  # it has just left
                for service, own in node.get_service_names_and_types_by_node(owner, place):
                    if service == name:
                        return own[0]
        return types[0]

    def _strangers(self, topic: str) -> int:
        """Count the subscribers except gateways, whose subscriptions do not execute commands."""
        node: Any = self._ros.node
        own = node.get_fully_qualified_name()
        found = node.get_subscriptions_info_by_topic(topic)
        return sum(node_of(info) != own for info in found)

    def _choose(self, name: str, types: list[str], disputed: dict[str, str]) -> str:
        """Return the type that other publishers use; the gateway also lists its own type."""
        node: Any = self._ros.node
        own = node.get_fully_qualified_name()
        offers: dict[str, str] = {
            info.topic_type: node_of(info) or "a node"
            for info in node.get_publishers_info_by_topic(name)
            if node_of(info) != own
        }
        offered: list[str] = sorted(offers) or types
        chosen = self._chosen.get(name, "")
        if chosen not in offered:
            chosen = self._chosen[name] = offered[0]
        if len(offers) > 1:
            each = ", ".join(
                f"{type_} by {publisher}" for type_, publisher in sorted(offers.items())
            )
            disputed[name] = f"{name} is published as {each}; only {chosen} is read"
        return chosen
