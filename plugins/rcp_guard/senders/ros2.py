"""ROS 2 messages, cancellations and service calls, by a separate node.

Nothing is received, so nothing spins: the sending thread itself publishes and calls. The node's
name starts with `rcp_guard`, by which others recognise its publishers.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import tempfile
import threading
import time
from collections.abc import Callable
from typing import Any

from rcp_guard.senders import MissingLibraryError

__all__ = ["open_sender"]

_CALLS = 0.5  # s between calls of the same service: each is work for the robot


_nodes: dict[int | None, _Node] = {}
_lock = threading.Lock()  # of the nodes: each plan has its own thread


class _Node:
    """A node of one domain, shared by its plans: each node costs a DDS participant."""

    def __init__(self, domain: int | None) -> None:
        import rclpy
        import rclpy.signals
        from rclpy.context import Context
        from rclpy.node import Node

        self.users = 0
        self._domain = domain
        self._context = Context()
        rclpy.init(
            context=self._context,
            domain_id=domain,
            signal_handler_options=rclpy.signals.SignalHandlerOptions.NO,
        )
        self.node = Node(
            f"rcp_guard_{os.getpid()}",
            context=self._context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )

    def leave(self) -> None:
        """Leave the graph with the last user; call it with the lock held."""
        self.users -= 1
        if self.users == 0:
            del _nodes[self._domain]
            with contextlib.suppress(Exception):
                self.node.destroy_node()
                self._context.shutdown()


class Ros2Sender:
    """Publishes, cancels and calls what a plan contains."""

    def __init__(self, shared: _Node, data: dict[str, Any]) -> None:
        self._shared = shared
        self._publishers: list[tuple[Any, bytes]] = []
        self._calls: list[tuple[Any, Any]] = []
        self._called = float("-inf")
        self._unusable: list[str] = []
        for one in data.get("publishers", ()):
            self._add(self._publishers, _publisher, one)
        for name in data.get("cancel", ()):
            self._add(self._calls, _cancel, name)
        for one in data.get("services", ()):
            self._add(self._calls, _call, one)

    def _add(self, to: list[Any], make: Callable[[Any, Any], Any], one: Any) -> None:
        """Build one part of the plan; a failure does not prevent the others."""
        try:
            to.append(make(self._shared.node, one))
        except (MissingLibraryError, KeyError, ValueError) as error:
            self._unusable.append(str(error))

    @property
    def unusable(self) -> str:
        """The parts whose types are not installed."""
        return ", ".join(self._unusable)

    def check(self) -> None:
        """Refuse a plan of which nothing can be sent.

        :raises MissingLibraryError: none of its parts can be sent.
        """
        if not (self._publishers or self._calls):
            raise MissingLibraryError(self.unusable or "the plan is empty")

    def send(self) -> None:
        """Publish everything; cancel and call on available servers."""
        for publisher, message in self._publishers:
            publisher.publish(message)
        if time.monotonic() - self._called >= _CALLS:
            self._called = time.monotonic()
            for client, request in self._calls:
                if client.service_is_ready():
                    client.remove_pending_request(client.call_async(request))

    def lacks(self) -> str:
        """List the topics without a subscriber, and the services and actions without a server."""
        topics = [p.topic_name for p, _ in self._publishers if p.get_subscription_count() == 0]
        services = [c.srv_name for c, _ in self._calls if not c.service_is_ready()]
        missing = [f"no subscriber of {name}" for name in topics]
        missing += [f"no server of {name}" for name in services]
        return ", ".join([*self._unusable, *missing])

    def close(self) -> None:
        """Destroy everything."""
        node = self._shared.node
        with _lock:
            with contextlib.suppress(Exception):
                for publisher, _ in self._publishers:
                    node.destroy_publisher(publisher)
                for client, _ in self._calls:
                    node.destroy_client(client)
            self._shared.leave()


def open_sender(data: dict[str, Any]) -> Ros2Sender:
    """Join the graph and create all publishers and clients."""
    os.environ.setdefault("ROS_LOG_DIR", tempfile.gettempdir())
    domain = data.get("domain_id")
    with _lock:
        shared = _nodes.get(domain)
        if shared is None:
            try:
                shared = _nodes[domain] = _Node(domain)
            except ImportError as error:
                text = f"{error}; try: pip install 'rcp-gateway[ros2]'"
                raise MissingLibraryError(text) from error
        shared.users += 1
        sender = Ros2Sender(shared, data)
    try:
        sender.check()
    except MissingLibraryError:
        sender.close()
        raise
    return sender


def _type(name: str) -> Any:
    try:
        package, kind, word = name.split("/")
        return getattr(importlib.import_module(f"{package}.{kind}"), word)
    except (ValueError, ImportError, AttributeError) as error:
        raise MissingLibraryError(f"the ROS type '{name}' is not installed: {error}") from error


def _publisher(node: Any, one: dict[str, Any]) -> tuple[Any, bytes]:
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    reliable = one.get("reliable", True)
    policy = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    # The newest only: a stop must not wait for a subscriber that does not acknowledge.
    quality = QoSProfile(depth=1, reliability=policy)
    publisher = node.create_publisher(_type(one["type"]), one["topic"], quality)
    return publisher, bytes.fromhex(one["data"])


def _cancel(node: Any, action: str) -> tuple[Any, Any]:
    cancel = _type("action_msgs/srv/CancelGoal")
    # action_msgs/CancelGoal: a goal of zeros at the time zero means all goals.
    return node.create_client(cancel, f"{action}/_action/cancel_goal"), cancel.Request()


def _call(node: Any, one: dict[str, Any]) -> tuple[Any, Any]:
    from rclpy.serialization import deserialize_message

    type_ = _type(one["type"])
    request = deserialize_message(bytes.fromhex(one["data"]), type_.Request)
    return node.create_client(type_, one["name"]), request
