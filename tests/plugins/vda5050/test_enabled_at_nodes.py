"""Zone sets and maps that a node of an order enables: without them the robot does not drive on."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from plugins.vda5050.broker import MOSQUITTO
from plugins.vda5050.test_orders import order
from plugins.vda5050.test_robot import Depot, depot, done, drives
from plugins.vda5050.test_zones import kinds
from plugins.vda5050.zones import box, check_state, keep, listed, zone_set

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(
        MOSQUITTO is None and not os.environ.get("RCP_CI"), reason="needs Mosquitto"
    ),
]
OLD, NEW = box("far", "BLOCKED", 20.0, 21.0), box("far", "BLOCKED", 30.0, 31.0)


def act(id_: str, kind: str, blocking: str = "HARD", **parameters: str) -> dict[str, Any]:
    return {
        "actionType": kind, "actionId": id_, "blockingType": blocking,
        "actionParameters": [{"key": k, "value": v} for k, v in parameters.items()],
    }  # fmt: skip


async def send(it: Depot, given: dict[str, Any]) -> None:
    for node in given["nodes"]:
        node["nodePosition"]["x"] *= 0.4
    names = ("orderId", "orderUpdateId", "nodes", "edges")
    await it.master.send("r1", "order", **{name: given[name] for name in names})


async def held(it: Depot, id_: str, node: str) -> None:
    """Wait until the order is held at a node because of an action."""
    state = await it.master.until("r1", lambda s: "NOT_ENABLED" in kinds(s))
    assert (state["paused"], state["driving"], state["lastNodeId"]) == (True, False, node)
    assert {a["actionId"]: a["actionStatus"] for a in state["actionStates"]}[id_] == "FAILED"
    fault = next(e for e in state["errors"] if e["errorType"] == "NOT_ENABLED")
    assert fault["errorLevel"] == "CRITICAL"
    assert {"referenceKey": "actionId", "referenceValue": id_} in fault["errorReferences"]
    assert "as an instant action and then stopPause" in fault["errorHint"]


async def test_an_order_is_held_where_its_zone_set_or_map_cannot_be_enabled(tmp_path: Path) -> None:
    async with depot(tmp_path, version="3.0") as it:
        await keep(it.master, "old", OLD)
        given = order("o1")
        given["nodes"][1]["actions"] = [act("a1", "enableZoneSet", zoneSetId="new")]
        given["nodes"][2]["actions"] = [act("a2", "enableMap", mapId="roof", mapVersion="1")]
        await send(it, given)
        await held(it, "a1", "n1")
        assert listed(it.master.last("r1")) == [("old", "ENABLED")]
        assert len(await drives(it)) == 1
        await it.estop()
        await it.master.until("r1", lambda s: s["safetyState"]["activeEmergencyStop"] != "NONE")
        await it.estop(reset=True)
        await it.master.until("r1", lambda s: s["safetyState"]["activeEmergencyStop"] == "NONE")
        assert "NOT_ENABLED" in kinds(it.master.last("r1"))  # its hint counts, not that of the stop
        await it.master.send("r1", "zoneSet", **zone_set("new", NEW))
        await it.master.instant("r1", "enableZoneSet", zoneSetId="new")
        await it.master.until("r1", lambda s: ("new", "ENABLED") in listed(s))
        assert it.master.last("r1")["paused"]
        await it.master.instant("r1", "stopPause")
        await it.master.until("r1", done("o1", "n2"))
        await held(it, "a2", "n2")  # though nothing of the order is left
        await send(it, order("o1", 1, first=2, count=2))
        state = await it.master.until("r1", lambda s: s["orderUpdateId"] == 1)
        assert [each["nodeId"] for each in state["nodeStates"]] == ["n3"]
        assert state["paused"]
        assert len(await drives(it)) == 2
        await it.master.instant("r1", "cancelOrder")
        state = await it.master.until("r1", lambda s: not s["nodeStates"] and not s["paused"])
        assert "NOT_ENABLED" not in kinds(state)
        for each in it.master.heard["r1", "state"]:
            check_state(each)


async def test_a_robot_that_drives_on_meanwhile_is_stopped(tmp_path: Path) -> None:
    async with depot(tmp_path, version="2.1") as it:
        given = order("o1", count=2)
        given["nodes"][0]["actions"] = [act("a1", "enableMap", "NONE", mapId="roof")]
        given["nodes"][1]["nodePosition"]["x"] = 20.0
        await send(it, given)
        state = await it.master.until("r1", lambda s: s["paused"] and not s["driving"])
        levels = {e["errorLevel"] for e in state["errors"] if e["errorType"] == "actionError"}
        assert "FATAL" in levels
        assert [each["nodeId"] for each in state["nodeStates"]] == ["n1"]
