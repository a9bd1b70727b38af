"""Clients of actions, which live as long as the thread.

The events executor ends the process when a client of an action is destroyed just as something
arrives for it, such as feedback: it then releases Python objects without Python's lock. So a client
whose action has another type by now stays, too.
"""

from __future__ import annotations

from typing import Any

from rcp_ros2.ros import Ros

__all__ = ["ActionClients"]


class ActionClients:
    """One client of each action and type; in the ROS thread."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._clients: dict[str, dict[Any, Any]] = {}
        """By name and type."""
        self._nodes: list[Any] = []
        """For the second types of names, the third ones, and so on."""

    def of(self, action: Any, name: str) -> Any:
        """Return the client of an action, which the caller does not destroy."""
        known = self._clients.setdefault(name, {})
        client = known.get(action)
        if client is None:
            from rclpy.action.client import ActionClient

            client = known[action] = ActionClient(self._node(len(known)), action, name)
        return client

    def _node(self, others: int) -> Any:
        """Return the node for a client beside so many others of its name."""
        if not others:
            return self._ros.node
        while len(self._nodes) < others:
            self._nodes.append(self._ros.add_node(f"actions_{len(self._nodes) + 1}"))
        return self._nodes[others - 1]

    def release(self) -> None:
        """Destroy them: they would keep their nodes; when the executor has ended."""
        while self._clients:
            for client in self._clients.popitem()[1].values():
                client.destroy()
