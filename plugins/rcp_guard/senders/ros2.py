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
from pathlib import Path
from typing import Any

from rcp_guard.senders import MissingLibraryError

__all__ = ["open_sender"]

_CALLS = 0.5  # s between calls of the same service: each is work for the robot
_FOLLOWS = 0.3  # s in which a plan that replaces another takes over its node
_RANGE, _TRANSPORTS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTDDS_BUILTIN_TRANSPORTS"
_PEERS = "ROS_STATIC_PEERS"
_PROFILES = "FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE"
_LOOPBACK = Path(__file__).with_name("loopback.xml")


_nodes: dict[int | None, _Node] = {}
_lock = threading.Condition()  # of the nodes: each plan has its own thread


class _Node:
    """A node of one domain, shared by its plans: each node costs a DDS participant."""

    def __init__(self, domain: int | None) -> None:
        import rclpy
        import rclpy.signals
        from rclpy.context import Context
        from rclpy.node import Node
        from rclpy.utilities import get_rmw_implementation_identifier

        if get_rmw_implementation_identifier().startswith("rmw_fastrtps"):
            _leave_shared_memory_out()
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
        """Leave the graph with the last user; call it with the lock held.

        A plan that replaces another goes on with its node: until the robot has discovered a new
        one, which takes seconds now and then, no stop reaches it.
        """
        self.users -= 1
        _lock.wait_for(lambda: self.users > 0, _FOLLOWS)
        if self.users == 0 and _nodes.get(self._domain) is self:
            del _nodes[self._domain]
            with contextlib.suppress(Exception):
                self.node.destroy_node()
                self._context.shutdown()


def _leave_shared_memory_out() -> None:
    """Have Fast DDS use UDP alone, unless a profile says otherwise.

    A gateway that is killed may leave its shared memory locked, for seconds. On this machine only,
    ROS 2 adds shared memory to whatever transports are asked for, so a profile takes its place. It
    would not reach peers on other machines; with those, discovery stays as it was set.
    """
    if any(os.environ.get(name) for name in _PROFILES):
        return
    os.environ.setdefault(_TRANSPORTS, "UDPv4")
    if os.environ.get(_PEERS):
        return
    if os.environ.get(_RANGE) == "LOCALHOST" and os.environ[_TRANSPORTS] == "UDPv4":
        os.environ[_PROFILES[0]] = str(_LOOPBACK)
        os.environ[_RANGE] = "SYSTEM_DEFAULT"


class _Call:
    """A request, and when it may be sent again."""

    def __init__(self, client: Any, request: Any) -> None:
        self.client, self._request = client, request
        self._due = float("-inf")

    def send(self, now: float) -> None:
        """Send it if that is due; a server that is not there yet is called as soon as it is."""
        if now >= self._due and self.client.service_is_ready():
            self._due = now + _CALLS
            self.client.remove_pending_request(self.client.call_async(self._request))


class Ros2Sender:
    """Publishes, cancels and calls what a plan contains."""

    def __init__(self, shared: _Node, data: dict[str, Any]) -> None:
        self._shared = shared
        self._publishers: list[tuple[Any, bytes]] = []
        self._calls: list[_Call] = []
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
        now = time.monotonic()
        for call in self._calls:
            call.send(now)

    def lacks(self) -> str:
        """List the topics without a subscriber, and the services and actions without a server."""
        topics = [p.topic_name for p, _ in self._publishers if p.get_subscription_count() == 0]
        services = [c.client.srv_name for c in self._calls if not c.client.service_is_ready()]
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
                for call in self._calls:
                    node.destroy_client(call.client)
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
        _lock.notify_all()
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


def _cancel(node: Any, action: str) -> _Call:
    cancel = _type("action_msgs/srv/CancelGoal")
    # action_msgs/CancelGoal: a goal of zeros at the time zero means all goals.
    return _Call(node.create_client(cancel, f"{action}/_action/cancel_goal"), cancel.Request())


def _call(node: Any, one: dict[str, Any]) -> _Call:
    from rclpy.serialization import deserialize_message

    type_ = _type(one["type"])
    request = deserialize_message(bytes.fromhex(one["data"]), type_.Request)
    return _Call(node.create_client(type_, one["name"]), request)
