"""Is the peer alive? Asked of its node, because the graph does not know for a long time.

A node that was killed is listed until its lease ends. What answers for it at once is its own
parameter service, which every ordinary node has: asking for no parameters costs it nothing.
"""

from __future__ import annotations

import time
from typing import Any

from rcp_ros2.ros import Ros

__all__ = ["Probe"]


class Probe:
    """Asks the node behind one action, in the ROS thread, and notes when it answered."""

    def __init__(self, ros: Ros, action: str) -> None:
        self._ros = ros
        self._topic = f"{action}/_action/status"
        self._client: Any = None
        self._node = ""
        self._pending: Any = None
        self.answers = 0
        """How often the node has answered."""
        self.heard = 0.0
        """When it last did, in monotonic time."""

    def servers(self) -> frozenset[bytes]:
        """Return who publishes the action's status: a new one is a server that was restarted."""
        endpoints = self._ros.node.get_publishers_info_by_topic(self._topic)
        named = [e for e in endpoints if not e.node_name.startswith("_")]
        if named:
            self._address(f"{named[-1].node_namespace.rstrip('/')}/{named[-1].node_name}")
        return frozenset(bytes(e.endpoint_gid) for e in endpoints)

    def _address(self, node: str) -> None:
        if node != self._node:
            self.close()
            from rcl_interfaces.srv import GetParameters

            self._node = node
            self._client = self._ros.node.create_client(GetParameters, f"{node}/get_parameters")

    def ask(self) -> None:
        """Send a question, unless one is on its way or nobody could answer it."""
        if self._client is None or not self._client.service_is_ready():
            return
        if self._pending is not None:
            self._client.remove_pending_request(self._pending)
        self._pending = self._client.call_async(self._client.srv_type.Request())
        self._pending.add_done_callback(self._answered)

    def _answered(self, future: Any) -> None:
        if future is self._pending:
            self._pending = None
        self.answers += 1
        self.heard = time.monotonic()

    def close(self) -> None:
        """Let go of the client."""
        if self._client is not None:
            self._ros.node.destroy_client(self._client)
            self._client = self._pending = None
            self._node = ""
