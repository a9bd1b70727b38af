"""Liveness of nodes, polled once per second because the graph detects a dead node late.

A killed node is listed until the lease of its process ends, 20 s with Fast DDS. Every ordinary node
has a parameter service, and an empty request to it is cheap. A node that has never responded is not
judged.

Everything here runs in the ROS thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from rcp_ros2.ros import Ros

__all__ = ["Pulse", "Pulses", "node_of"]

_EVERY = 0.9  # s between two requests
_DUE = 0.4  # s for a response, before another request makes sense


def node_of(endpoint: Any) -> str | None:
    """Return the full name of the node of an endpoint; None while it is unknown."""
    if endpoint.node_name.startswith("_"):  # _NODE_NAME_UNKNOWN_
        return None
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


class Pulse:
    """One monitored node."""

    def __init__(self, ros: Ros, node: str) -> None:
        from rcl_interfaces.srv import GetParameters

        self._ros = ros
        self._client: Any = ros.node.create_client(GetParameters, f"{node}/get_parameters")
        self._pending: Any = None
        self._requested_at = float("-inf")
        self.answers = 0
        """Number of responses from the node."""
        self.last_response = float("-inf")
        """Monotonic time of the last response, s; -inf before the first."""

    def ping(self) -> None:
        """Send a request; an older one is abandoned, unless a response may still arrive."""
        now = time.monotonic()
        if not self._client.service_is_ready():
            return
        if self._pending is not None and now - self._requested_at < _DUE:
            return
        self._requested_at = now
        if self._pending is not None:
            self._client.remove_pending_request(self._pending)
        self._pending = self._client.call_async(self._client.srv_type.Request())
        self._pending.add_done_callback(self._answered)

    def _answered(self, future: Any) -> None:
        if future is self._pending:
            self._pending = None
        self.answers += 1
        self.last_response = time.monotonic()

    @property
    def silence(self) -> float:
        """Seconds since the last response while one is due; 0 for a node that never responded."""
        if not self.answers or self._pending is None:
            return 0.0
        return time.monotonic() - self.last_response

    def close(self) -> None:
        """Destroy the client."""
        self._ros.node.destroy_client(self._client)


class Pulses:
    """The monitored nodes."""

    def __init__(self, ros: Ros, complain: Callable[[str, str | None], None]) -> None:
        self._ros = ros
        self._complain = complain
        self._wanted: dict[str, frozenset[str]] = {}
        self._pulses: dict[str, Pulse] = {}
        self._next = 0.0

    def want(self, key: str, nodes: Iterable[str]) -> None:
        """Set the nodes that the caller `key` monitors; none ends it."""
        named = frozenset(nodes)
        if self._wanted.get(key, frozenset()) == named:
            return
        if named:
            self._wanted[key] = named
        else:
            del self._wanted[key]
        wanted = frozenset[str]().union(*self._wanted.values())
        for node in wanted - self._pulses.keys():
            self._pulses[node] = Pulse(self._ros, node)
        for node in self._pulses.keys() - wanted:
            self._pulses.pop(node).close()
            self._complain(node, None)

    def of(self, node: str) -> Pulse | None:
        """Return the monitor of a node, if it is monitored."""
        return self._pulses.get(node)

    def ping(self, nodes: Iterable[str]) -> None:
        """Poll some nodes now; those that respond are alive."""
        for node in nodes:
            if (pulse := self._pulses.get(node)) is not None:
                pulse.ping()

    def poll(self) -> None:
        """Poll every node and report those that have stopped responding."""
        now = time.monotonic()
        due = now >= self._next
        if due:
            self._next = now + _EVERY
        for node, pulse in self._pulses.items():
            if pulse.answers and not due:  # get the first response soon
                continue
            gone = self.is_silent(node)
            self._complain(node, f"the node {node} no longer responds" if gone else None)
            pulse.ping()

    def is_silent(self, node: str) -> bool:
        """Return whether a node that responded before no longer does."""
        pulse = self._pulses.get(node)
        return pulse is not None and pulse.silence > self._ros.config.silence
