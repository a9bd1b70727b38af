"""The trajectory controllers in the graph, with what their nodes and descriptions say of the joints."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from rcp_ros2.arm import ArmJoints
from rcp_ros2.conventions import JOINT_TRAJECTORY
from rcp_ros2.description import Descriptions
from rcp_ros2.graph import Graph
from rcp_ros2.link import RosLink
from rcp_ros2.parameters import NodeParameters

__all__ = ["ARM", "Arms"]

ARM = ("action/move_joints", "action/follow_trajectory")
_STRINGS = 9  # in rcl_interfaces/msg/ParameterType


class Arms:
    """What is known of each controller."""

    def __init__(self, link: RosLink, descriptions: Descriptions) -> None:
        self._link = link
        self._descriptions = descriptions
        self.joints: dict[str, tuple[str, ...]] = {}
        """The joints by action, in the controller's order; none if it does not tell."""

    def unknown(self, graph: Graph, is_conventional: Callable[[str], bool]) -> list[str]:
        """Return the actions whose controllers are to be asked."""
        return [
            name
            for name, type_ in graph.actions.items()
            if type_ == JOINT_TRAJECTORY
            and name not in self.joints
            and is_conventional(name)
            and controller_of(name) in graph.nodes
        ]

    async def ask(self, action: str, node_of: Callable[[str], Awaitable[NodeParameters]]) -> None:
        """Ask a controller for its joints.

        :raises RcpError: it does not respond.
        """
        found = await (await node_of(controller_of(action))).get("joints", _STRINGS)
        self.joints[action] = tuple(found or ())

    def is_known(self, action: str) -> bool:
        """Return whether a controller was asked, or cannot be, and its description received."""
        if not self._link.settling:
            return action in self.joints or controller_of(action) not in self._link.graph.nodes
        space = self._link.naming.split(action)[1]
        return action in self.joints and not self._descriptions.is_awaited(space)

    def of(self, action: str) -> ArmJoints:
        """Return the joints of a controller, with their limits."""
        names = self.joints.get(action, ())
        found = self._descriptions.of(self._link.naming.split(action)[1])
        known = found.joints if found is not None else {}
        return ArmJoints(names, tuple((name, known[name]) for name in names if name in known))


def controller_of(action: str) -> str:
    """Return the node of a controller's action."""
    return action.rpartition("/")[0]
