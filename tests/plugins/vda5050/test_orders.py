"""Orders: accepted as a whole or refused as a whole, with base and horizon as VDA 5050 has them."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rcp_vda5050.faults import OrderRefused
from rcp_vda5050.messages import Action, Order
from rcp_vda5050.orders import OrderBook

HERE = (0.0, 0.0)


def order(
    id_: str = "o1",
    update: int = 0,
    *,
    released: int = 3,
    first: int = 0,
    count: int = 3,
    **more: Any,
) -> dict[str, Any]:
    """Return an order of nodes n0, n1… a metre apart, of which the first ones are released."""
    nodes = [
        {
            "nodeId": f"n{n}", "sequenceId": 2 * n, "released": n - first < released, "actions": [],
            "nodePosition": {"x": float(n), "y": 0.0, "mapId": "hall"},
        }
        for n in range(first, first + count)
    ]  # fmt: skip
    edges = [
        {
            "edgeId": f"e{n}", "sequenceId": 2 * n + 1, "released": n + 1 - first < released,
            "startNodeId": f"n{n}", "endNodeId": f"n{n + 1}", "actions": [],
        }
        for n in range(first, first + count - 1)
    ]  # fmt: skip
    return {
        "headerId": 1, "timestamp": "2026-01-01T00:00:00.000Z", "version": "2.1.0", "manufacturer": "acme",
        "serialNumber": "r1", "orderId": id_, "orderUpdateId": update, "nodes": nodes, "edges": edges, **more,
    }  # fmt: skip


def action(id_: str, kind: str = "pick", blocking: str = "HARD") -> dict[str, Any]:
    return {"actionType": kind, "actionId": id_, "blockingType": blocking}


def decoded(given: dict[str, Any]) -> Order:
    return msgspec.json.decode(msgspec.json.encode(given), type=Order)


def book() -> OrderBook:
    def refuses(given: Action) -> str | None:
        return None if given.action_type == "pick" else f"there is no action {given.action_type}"

    return OrderBook("hall", 0.5, refuses, lambda _start, end: "wall" if end[1] > 50 else None)


def taken(
    given: dict[str, Any], of: OrderBook, *, busy: bool = False, here: tuple[float, float] = HERE
) -> list[str] | None:
    actions = of.take(decoded(given), here, busy=busy)
    return None if actions is None else [each.action_id for each in actions]


def refused(given: dict[str, Any], of: OrderBook, *, busy: bool = False) -> str:
    before = (of.order_id, of.update_id, list(of.legs))
    with pytest.raises(OrderRefused) as error:
        of.take(decoded(given), HERE, busy=busy)
    assert (of.order_id, of.update_id, of.legs) == before
    return error.value.fault.kind


def test_the_base_is_driven_and_the_horizon_is_not() -> None:
    it = book()
    assert taken(order(released=2), it) == []
    assert [leg.node.node_id for leg in it.legs] == ["n0", "n1", "n2"]
    assert it.next is not None
    assert it.next.edge is None
    it.reached()
    assert it.base_ends
    it.reached()
    assert it.next is None
    assert (it.last_node, it.last_sequence, len(it.legs)) == ("n1", 2, 1)


def test_an_update_replaces_the_horizon_and_goes_on_where_the_base_ends() -> None:
    it = book()
    taken(order(released=2), it)
    it.reached()
    longer = order(update=1, first=1, count=4, released=3)
    longer["nodes"][0]["actions"] = [action("a1")]
    assert taken(longer, it) == ["a1"]
    assert [leg.node.node_id for leg in it.legs] == ["n1", "n2", "n3", "n4"]
    assert [leg.node.released for leg in it.legs] == [True, True, True, False]
    assert it.legs[0].edge is not None


def test_an_update_of_a_finished_base_begins_where_the_robot_is() -> None:
    it = book()
    taken(order(), it)
    for _ in range(3):
        it.reached()
    assert taken(order(update=4, first=2), it) == []
    assert [leg.node.node_id for leg in it.legs] == ["n3", "n4"]


def test_what_is_known_already_changes_nothing() -> None:
    it = book()
    taken(order(), it)
    it.reached()
    assert taken(order(), it) is None
    assert len(it.legs) == 2


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        (order("o2"), "other_order"),
        (order(update=0, released=3), "outdated"),
        (order(update=3, first=1), "stitching"),
        (order(update=3, first=3), "stitching"),
    ],
)
def test_an_update_that_does_not_fit_is_refused(given: dict[str, Any], kind: str) -> None:
    it = book()
    taken(order(update=2), it)
    assert refused(given, it) == kind


def changed(**where: Any) -> dict[str, Any]:
    made = order()
    for place, value in where.items():
        branch, number, name = place.split("__")
        made[branch][int(number)][name] = value
    return made


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        (changed(nodes__1__nodePosition=None), "malformed"),
        (changed(nodes__1__sequenceId=1), "malformed"),
        (changed(nodes__0__released=False), "malformed"),
        (changed(nodes__1__released=False), "malformed"),
        (changed(edges__0__released=False), "malformed"),
        (changed(edges__0__endNodeId="n7"), "malformed"),
        (changed(nodes__2__nodePosition={"x": 1, "y": 1, "mapId": "roof"}), "map"),
        (changed(nodes__0__nodePosition={"x": 3, "y": 0, "mapId": "hall"}), "start"),
        (changed(nodes__2__nodePosition={"x": 1, "y": 60, "mapId": "hall"}), "route"),
        (changed(edges__1__trajectory={"degree": 1}), "unsupported"),
        (changed(edges__0__corridor={"leftWidth": 1, "rightWidth": 1}), "unsupported"),
        (changed(nodes__1__actions=[action("a", "dance")]), "action"),
        (changed(nodes__1__actions=[action("a")], edges__1__actions=[action("a")]), "malformed"),
        (order(edges=[]), "malformed"),
    ],
)
def test_a_wrong_order_is_refused_as_a_whole(given: dict[str, Any], kind: str) -> None:
    assert refused(given, book()) == kind


def test_nothing_is_begun_while_actions_still_run() -> None:
    it = book()
    taken(order(count=1), it)
    it.reached()
    assert refused(order("o2"), it, busy=True) == "other_order"
    assert taken(order("o2"), it) == []


def test_an_order_may_begin_anywhere_within_its_own_deviation_or_on_the_last_node() -> None:
    at = {"x": 2.0, "y": 0.0, "mapId": "hall"}
    assert taken(changed(nodes__0__nodePosition=at | {"allowedDeviationXY": 2.5}), book()) == []
    ellipse = {"a": 3.0, "b": 2.1, "theta": 0.0}
    assert taken(changed(nodes__0__nodePosition=at | {"allowedDeviationXY": ellipse}), book()) == []
    it = book()
    it.last_node = "n0"
    assert taken(changed(nodes__0__nodePosition=at), it) == []


def test_a_cancel_drops_what_is_left_and_no_update_brings_it_back() -> None:
    it = book()
    taken(order(released=2), it)
    it.reached()
    it.reached()
    it.cancel()
    assert it.legs == []
    assert it.order_id == "o1"
    assert refused(order(update=1, first=1), it) == "cancelled"
    assert taken(order("o2", first=1), it, here=(1.0, 0.0)) == []


def test_actions_of_the_last_node_are_not_done_again_by_an_update_that_repeats_them() -> None:
    it = book()
    given = order(count=2)
    given["nodes"][1]["actions"] = [action("a1")]
    assert taken(given, it) == ["a1"]
    it.reached()
    it.reached()
    longer = order(update=1, first=1, count=2)
    longer["nodes"][0]["actions"] = [action("a1"), action("a2")]
    found = it.take(decoded(longer), HERE, busy=False, known={"a1"})
    assert [each.action_id for each in found or []] == ["a2"]
    assert [[a.action_id for a in leg.node.actions] for leg in it.legs] == [["a2"], []]
