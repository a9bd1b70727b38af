"""Clients of actions, which live as long as the node.

The events executor ends the process when a client of an action is destroyed just as something
arrives for it, such as feedback: it then releases Python objects without Python's lock.
"""

from __future__ import annotations

from typing import Any

from rcp_ros2.ros import Ros

__all__ = ["ActionClients"]


class ActionClients:
    """One client of each action; in the ROS thread."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._clients: dict[str, tuple[Any, Any]] = {}

    def of(self, action: Any, name: str) -> Any:
        """Return the client of an action, which the caller does not destroy.

        None: one of another type has to go first; ask again.
        """
        known, client = self._clients.get(name, (None, None))
        if known is action:
            return client
        if client is not None:  # the middleware has one type of each name
            del self._clients[name]
            client.destroy()
            return None
        from rclpy.action.client import ActionClient

        client = ActionClient(self._ros.node, action, name)
        self._clients[name] = action, client
        return client

    def release(self) -> None:
        """Destroy them: they would keep the node; when its executor has ended."""
        while self._clients:
            self._clients.popitem()[1][1].destroy()
