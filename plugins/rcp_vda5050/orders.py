"""The order of one robot: what is left of its base and horizon, and what an update may change.

VDA 5050 2.1 section 6.6.2 to 6.6.4: an order is refused as a whole or accepted as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from itertools import pairwise
from typing import NamedTuple

from msgspec.structs import replace

from rcp_geometry import Corner
from rcp_vda5050.faults import Fault, FaultKind, OrderRefused
from rcp_vda5050.messages import Action, Edge, Node, Order

__all__ = ["Leg", "OrderBook"]

Refuses = Callable[[Action], str | None]
"""Tells why an action cannot be done; None: it can."""


Blocks = Callable[[Corner, Corner], str | None]
"""Tells which BLOCKED zone lies on a straight way; None: none does."""


class Leg(NamedTuple):
    """A node to reach, and the edge that leads there; the first node of an order has none."""

    edge: Edge | None
    node: Node


class OrderBook:
    """The present order, or the last one."""

    def __init__(
        self,
        map_: str,
        start_range: float,
        refuses: Refuses,
        blocks: Blocks,
        refuses_at_node: Refuses | None = None,
    ) -> None:
        self._map, self._start_range, self._refuses = map_, start_range, refuses
        self._blocks, self._refuses_at_node = blocks, refuses_at_node or refuses
        self.order_id = ""
        self.update_id = 0
        self.last_node = ""
        self.last_sequence = 0
        self._cancelled = False
        self.legs: list[Leg] = []
        """What is left, base and horizon."""

    @property
    def next(self) -> Leg | None:
        """The next leg of the base."""
        return self.legs[0] if self.legs and self.legs[0].node.released else None

    @property
    def base_ends(self) -> bool:
        """Whether the robot is on the last leg of the base, and a horizon follows."""
        return len(self.legs) > 1 and not self.legs[1].node.released

    def reached(self) -> Node:
        """Note that the next node was reached; return it."""
        node = self.legs.pop(0).node
        self.last_node, self.last_sequence = node.node_id, node.sequence_id
        return node

    def cancel(self) -> None:
        """Drop what is left; updates that come later are of no use."""
        self.legs.clear()
        self._cancelled = True

    def take(
        self,
        order: Order,
        here: tuple[float, float] | None,
        *,
        busy: bool,
        known: Collection[str] = (),
    ) -> list[Action] | None:
        """Accept an order or an update; return its new actions, or None if it is known already.

        `here` is the robot's position; `busy` tells whether something of the present order still runs;
        `known` are the ids of its actions so far, which are not done again.

        :raises OrderRefused: it is wrong, or not for now; nothing has changed.
        """
        if order.order_id == self.order_id and order.order_update_id == self.update_id:
            return None
        _check_form(order)
        self._check_content(order)
        update = order.order_id == self.order_id
        legs = self._continued(order, known) if update else self._begun(order, here, busy=busy)
        self._cancelled = False
        self.order_id, self.update_id, self.legs = order.order_id, order.order_update_id, legs
        return [a for leg in legs for a in _actions(leg) if a.action_id not in known]

    def _begun(self, order: Order, here: tuple[float, float] | None, *, busy: bool) -> list[Leg]:
        if self.legs or busy:
            raise _refused(
                order,
                "other_order",
                f"order {self.order_id} is not finished",
                "Cancel it first, or update it.",
            )
        first = order.nodes[0]
        position = first.node_position
        on_it = first.node_id == self.last_node
        if here is None or position is None:
            raise _refused(order, "unavailable", "the robot's position is not known")
        reach = max(position.tolerance or 0.0, self._start_range)
        if not on_it and position.distance(*here) > reach:
            raise _refused(
                order, "start", f"the robot is {position.distance(*here):.2f} m from the first node, {first.node_id}",
                f"Begin the order within {reach:g} m of the robot.", ("nodeId", first.node_id),
            )  # fmt: skip
        return [Leg(None, first), *_legs(order)]

    def _continued(self, order: Order, known: Collection[str]) -> list[Leg]:
        if self._cancelled:
            raise _refused(order, "cancelled", "the order was cancelled", "Send another order.")
        if order.order_update_id < self.update_id:
            raise _refused(order, "outdated", f"update {self.update_id} was accepted already")
        first = order.nodes[0]
        base = [leg for leg in self.legs if leg.node.released]
        end = (
            (base[-1].node.node_id, base[-1].node.sequence_id)
            if base
            else (self.last_node, self.last_sequence)
        )
        if (first.node_id, first.sequence_id) != end:
            raise _refused(
                order, "stitching", f"the update begins at {first.node_id} ({first.sequence_id}), the base ends at {end[0]} ({end[1]})",
                "Begin the update with the last node of the base.", ("nodeId", first.node_id),
            )  # fmt: skip
        legs = _legs(order)
        added = tuple(action for action in first.actions if action.action_id not in known)
        if base:
            node = base[-1].node
            base[-1] = Leg(base[-1].edge, replace(node, actions=node.actions + added))
        elif added:
            legs.insert(0, Leg(None, replace(first, actions=added)))
        return base + legs

    def _check_content(self, order: Order) -> None:
        for node in order.nodes:
            at = node.node_position
            reference = ("nodeId", node.node_id)
            if at is None:
                raise _refused(
                    order, "malformed", f"node {node.node_id} has no position", "", reference
                )
            if at.map_id != self._map:
                raise _refused(
                    order, "map", f"there is no map {at.map_id}, but {self._map}", "", reference
                )
        for edge in order.edges:
            for name, given in (("trajectory", edge.trajectory), ("corridor", edge.corridor)):
                if given is not None:
                    raise _refused(
                        order, "unsupported", f"edge {edge.edge_id} has a {name}: the robot plans its own way",
                        f"Leave the {name} out.", ("parameter", f"order.edges.{name}"), ("edgeId", edge.edge_id),
                    )  # fmt: skip
        for parts, refuses in ((order.nodes, self._refuses_at_node), (order.edges, self._refuses)):
            for action in (action for part in parts for action in part.actions):
                if (reason := refuses(action)) is not None:
                    raise _refused(order, "action", reason, "", ("actionId", action.action_id))
        self._check_way(order)

    def _check_way(self, order: Order) -> None:
        """Check that no BLOCKED zone lies on it: the robot would not know to go round."""
        ways = zip(order.nodes[:1] + order.nodes, order.nodes, strict=False)
        for start, end in ways:
            assert start.node_position is not None
            assert end.node_position is not None
            zone = self._blocks(start.node_position.point, end.node_position.point)
            if zone is not None:
                raise _refused(
                    order, "route", f"zone {zone} is BLOCKED, and on the way to node {end.node_id}",
                    "Leave the zone out.", ("nodeId", end.node_id), ("zoneId", zone),
                )  # fmt: skip


def _actions(leg: Leg) -> tuple[Action, ...]:
    return (*(leg.edge.actions if leg.edge else ()), *leg.node.actions)


def _legs(order: Order) -> list[Leg]:
    return [Leg(edge, node) for edge, node in zip(order.edges, order.nodes[1:], strict=True)]


def _check_form(order: Order) -> None:
    nodes, edges = order.nodes, order.edges
    if len(edges) != len(nodes) - 1:
        raise _refused(
            order, "malformed", f"{len(nodes)} nodes need {len(nodes) - 1} edges, not {len(edges)}"
        )
    if not nodes[0].released:
        raise _refused(order, "malformed", "the first node is not released")
    for (start, end), edge in zip(pairwise(nodes), edges, strict=True):
        reference = ("edgeId", edge.edge_id)
        if not start.sequence_id < edge.sequence_id < end.sequence_id:
            raise _refused(
                order,
                "malformed",
                f"the sequenceId of edge {edge.edge_id} is not between those of its nodes",
                "",
                reference,
            )
        if edge.released != end.released or (end.released and not start.released):
            raise _refused(
                order, "malformed", f"the base has a gap at edge {edge.edge_id}", "", reference
            )
        ends = (edge.start_node_id or start.node_id, edge.end_node_id or end.node_id)
        if ends != (start.node_id, end.node_id):
            raise _refused(
                order,
                "malformed",
                f"edge {edge.edge_id} does not lead from {start.node_id} to {end.node_id}",
                "",
                reference,
            )
    ids = [action.action_id for action in order.actions]
    if len(set(ids)) != len(ids):
        raise _refused(order, "malformed", "two actions have the same actionId")


def _refused(
    order: Order, kind: FaultKind, text: str, hint: str = "", *references: Sequence[str]
) -> OrderRefused:
    named = [("orderId", order.order_id), ("orderUpdateId", str(order.order_update_id))]
    named += [(key, value) for key, value in references]
    return OrderRefused(Fault(kind, text, tuple(named), hint))
