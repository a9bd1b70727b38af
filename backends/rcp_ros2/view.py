"""The graph as a sensor: nodes, topics with their endpoints, services, actions.

The cost of a poll grows with the graph, so details are queried only while a client subscribes, and
only when names, types or counts have changed.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import msgspec

from rcp_kernel.model import Resource
from rcp_ros2.binding import Binding, Offer, Shared, common
from rcp_ros2.config import Mapping
from rcp_ros2.graph import Graph
from rcp_ros2.pulse import node_of
from rcp_ros2.qos import Terms, mismatches

__all__ = ["GraphView"]

_NAME = "sensor/ros/graph"
_AGAIN = 10.0  # s after which endpoints are queried again: one may have replaced another
_ACTION = "/_action/"


class Endpoint(msgspec.Struct, frozen=True):
    """An endpoint of a topic: its node, and the policies it offers or requests."""

    node: str
    reliability: str
    durability: str


class Topic(msgspec.Struct, frozen=True):
    """A topic, its publishers and subscribers, and why some of them cannot communicate."""

    name: str
    types: list[str]
    publishers: list[Endpoint]
    subscribers: list[Endpoint]
    mismatches: list[str]


class Offered(msgspec.Struct, frozen=True):
    """A service or an action."""

    name: str
    types: list[str]


class RosGraph(msgspec.Struct, frozen=True):
    """The ROS graph as the gateway sees it, itself included."""

    nodes: list[str]
    topics: list[Topic]
    services: list[Offered]
    actions: list[Offered]


class GraphView:
    """Provides the graph, if configured."""

    def __init__(self, shared: Shared) -> None:
        self._shared = shared

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return the sensor."""
        if not self._shared.config.graph:
            return {}
        mapping = Mapping(topic="/")
        return {_NAME: Offer(mapping, partial(View, self._shared, mapping))}


class View(Binding):
    """The graph."""

    def __init__(self, shared: Shared, mapping: Mapping) -> None:
        text = (
            "The ROS graph: nodes, topics with their publishers and subscribers, services, actions"
        )
        super().__init__(shared, Resource(value=RosGraph, **common(_NAME, mapping, text)), mapping)
        self._mark: Any = None
        self._looked = float("-inf")
        self._known: RosGraph | None = None

    async def read(self) -> Any:
        """Query the graph."""
        return await self.shared.ros.call(self._details)

    def watched(self, rate: float) -> None:
        """Publish the graph, and each change that a poll detects."""
        self.shared.ros.post(self._begin)

    def _begin(self) -> None:
        self._known = self._mark = None
        if self._poll not in self.shared.on_poll:
            self.shared.on_poll.append(self._poll)
        self._poll()

    def unwatched(self) -> None:
        """Stop polling."""
        self.shared.ros.post(self._end)

    def _end(self) -> None:
        if self._poll in self.shared.on_poll:
            self.shared.on_poll.remove(self._poll)

    def close(self) -> None:
        """Stop polling."""
        self.unwatched()

    # -- ROS thread ------------------------------------------------------------------------------

    def _poll(self) -> None:
        mark, now = self._fingerprint(), time.monotonic()
        if mark == self._mark and now - self._looked < _AGAIN:
            return
        self._mark, self._looked = mark, now
        graph = self._details()
        if graph != self._known:
            self._known = graph
            self.shared.host.call_soon(self.shared.host.publish, _NAME, graph)

    def _fingerprint(self) -> Any:
        node: Any = self.shared.ros.node
        topics = [
            (name, tuple(types), node.count_publishers(name), node.count_subscribers(name))
            for name, types in node.get_topic_names_and_types()
        ]
        services = [(name, node.count_services(name)) for name, _ in self._services()]
        return node.get_node_names_and_namespaces(), topics, services

    def _services(self) -> list[tuple[str, list[str]]]:
        return self.shared.ros.node.get_service_names_and_types()

    def _details(self) -> RosGraph:
        node: Any = self.shared.ros.node
        names = node.get_node_names_and_namespaces()
        # Clients list services too.
        services = [(n, types) for n, types in self._services() if node.count_services(n)]
        return RosGraph(
            nodes=sorted(f"{space.rstrip('/')}/{name}" for name, space in names),
            topics=[self._topic(node, n, types) for n, types in node.get_topic_names_and_types()],
            services=[Offered(n, types) for n, types in services if _ACTION not in n],
            actions=[
                Offered(n.partition(_ACTION)[0], [t.removesuffix("_SendGoal") for t in types])
                for n, types in services
                if n.endswith(f"{_ACTION}send_goal")
            ],
        )

    def _topic(self, node: Any, name: str, types: list[str]) -> Topic:
        publishers = node.get_publishers_info_by_topic(name)
        subscribers = node.get_subscriptions_info_by_topic(name)
        wrong = [f"its nodes disagree on its type: {', '.join(types)}"] if len(types) > 1 else []
        for publisher in publishers:
            for subscriber in subscribers:
                wrong += mismatches(Terms.of(publisher), Terms.of(subscriber))
        return Topic(
            name,
            types,
            sorted(map(_endpoint, publishers), key=_by_node),
            sorted(map(_endpoint, subscribers), key=_by_node),
            wrong,
        )


def _by_node(endpoint: Endpoint) -> tuple[str, str, str]:
    return endpoint.node, endpoint.reliability, endpoint.durability


def _endpoint(info: Any) -> Endpoint:
    profile = info.qos_profile
    return Endpoint(
        node_of(info) or "unknown",
        profile.reliability.name.lower(),
        profile.durability.name.lower(),
    )
