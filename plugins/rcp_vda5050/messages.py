"""What a fleet manager sends: orders and instant actions of VDA 5050 2.1 and 3.0."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field

__all__ = [
    "Action",
    "Addressed",
    "Blocking",
    "Edge",
    "Ellipse",
    "InstantActions",
    "Name",
    "Node",
    "NodePosition",
    "Order",
    "Parameter",
]

Number = Annotated[int, Meta(ge=0, lt=2**32)]
Name = Annotated[str, Meta(min_length=1, max_length=256)]
Angle = Annotated[float, Meta(ge=-3.1416, le=3.1416)]
Blocking = Literal["NONE", "SOFT", "SINGLE", "HARD"]
_MOST = 1000  # nodes of an order, actions of a node


class Parameter(Struct, frozen=True):
    """One parameter of an action."""

    key: Name
    value: Any


class Action(Struct, frozen=True, rename="camel"):
    """Something to do at a node, on an edge, or at once."""

    action_type: Name
    action_id: Name
    blocking_type: Blocking
    action_parameters: Annotated[tuple[Parameter, ...], Meta(max_length=_MOST)] = ()

    def parameter(self, key: str) -> str | None:
        """Return the text of a parameter; None: there is none."""
        found = (each.value for each in self.action_parameters if each.key == key)
        return next((each for each in found if isinstance(each, str)), None)


class Ellipse(Struct, frozen=True):
    """Allowed deviation of 3.0: semi-axes, and the angle of the first."""

    a: Annotated[float, Meta(ge=0)]
    b: Annotated[float, Meta(ge=0)]
    theta: float = 0.0


class NodePosition(Struct, frozen=True, rename="camel"):
    """Where a node is, m and rad."""

    x: float
    y: float
    map_id: Name
    theta: Angle | None = None
    deviation: float | Ellipse | None = field(name="allowedDeviationXY", default=None)

    @property
    def tolerance(self) -> float | None:
        """The radius of the circle within the allowed deviation; None: none was given, or no deviation."""
        given = self.deviation
        radius = min(given.a, given.b) if isinstance(given, Ellipse) else given
        return radius or None

    @property
    def point(self) -> tuple[float, float]:
        """Where it is."""
        return self.x, self.y

    def distance(self, x: float, y: float) -> float:
        """Return the distance of a position."""
        return math.hypot(self.x - x, self.y - y)


class Node(Struct, frozen=True, rename="camel"):
    """A node to reach."""

    node_id: Name
    sequence_id: Number
    released: bool
    actions: Annotated[tuple[Action, ...], Meta(max_length=_MOST)]
    node_position: NodePosition | None = None


class Edge(Struct, frozen=True, rename="camel"):
    """The way from one node to the next."""

    edge_id: Name
    sequence_id: Number
    released: bool
    actions: Annotated[tuple[Action, ...], Meta(max_length=_MOST)]
    start_node_id: str | None = None
    end_node_id: str | None = None
    max_speed: Annotated[float, Meta(gt=0)] | None = None
    maximum_speed: Annotated[float, Meta(gt=0)] | None = None
    trajectory: Any = None
    corridor: Any = None

    @property
    def speed(self) -> float | None:
        """The permitted speed by either version's name, m/s."""
        return self.max_speed or self.maximum_speed


class Addressed(Struct, frozen=True, rename="camel"):
    """The header of every message."""

    header_id: int
    timestamp: str
    version: str
    manufacturer: str
    serial_number: str


class Order(Addressed, frozen=True, rename="camel"):
    """An order, or the update of one."""

    order_id: Name
    order_update_id: Number
    nodes: Annotated[tuple[Node, ...], Meta(min_length=1, max_length=_MOST)]
    edges: Annotated[tuple[Edge, ...], Meta(max_length=_MOST)]

    @property
    def actions(self) -> list[Action]:
        """All of its actions."""
        return [action for each in (*self.nodes, *self.edges) for action in each.actions]


class InstantActions(Addressed, frozen=True, rename="camel"):
    """Actions to do at once."""

    actions: Annotated[tuple[Action, ...], Meta(max_length=_MOST)]
