"""Zones of VDA 5050 3.0 at a real broker: kept, refused, and enforced on a simulated rover's way."""

from __future__ import annotations

import json
import math
import os
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from configuration import table
from plugins.vda5050.broker import MOSQUITTO
from plugins.vda5050.test_orders import order
from plugins.vda5050.test_robot import Depot, depot, done, drives
from plugins.vda5050.zones import box, check_state, keep, listed, request, zone_set

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(
        MOSQUITTO is None and not os.environ.get("RCP_CI"), reason="needs Mosquitto"
    ),
]
RADIUS = 0.25  # m, of the circle around a robot of this size
SIZE = table("plugins.vda5050.robots.r1.factsheet", length=0.3, width=0.4)


@asynccontextmanager
async def zoned(folder: Path) -> AsyncGenerator[Depot]:
    """Run a depot of one robot with 3.0; what it says of zones is checked at the end."""
    async with depot(folder, version="3.0", more=SIZE) as it:
        yield it
        for state in it.master.heard["r1", "state"]:
            check_state(state)


async def send_order(
    it: Depot,
    *places: float,
    id_: str = "o1",
    speed: float | None = None,
    released: int = 9,
    **more: int,
) -> None:
    """Send the robot from place to place along a line."""
    given = order(id_, count=len(places), released=released, **more)
    for node, x in zip(given["nodes"], places, strict=True):
        node["nodePosition"]["x"] = x
    if speed is not None:
        given["edges"] = [each | {"maximumSpeed": speed} for each in given["edges"]]
    names = ("orderId", "orderUpdateId", "nodes", "edges")
    await it.master.send("r1", "order", **{name: given[name] for name in names})


async def answer(it: Depot, id_: str, grant: str, *, lease: float | None = None) -> None:
    """Answer a request; a lease ends in so many seconds."""
    found = {"requestId": id_, "grantType": grant}
    if lease is not None:
        until = datetime.now(UTC) + timedelta(seconds=lease)
        found["leaseExpiry"] = until.isoformat(timespec="milliseconds").replace("+00:00", "Z")
    await it.master.send("r1", "responses", responses=[found])


async def asked(it: Depot, zone: str) -> dict[str, Any]:
    """Wait for a request that is not answered yet."""
    state = await it.master.until("r1", lambda s: request(s, zone, "REQUESTED"))
    found = request(state, zone, "REQUESTED")
    assert found is not None
    return found


def kinds(state: dict[str, Any]) -> list[str]:
    return [each["errorType"] for each in state["errors"]]


def x_of(state: dict[str, Any]) -> float:
    return state["mobileRobotPosition"]["x"]


async def test_zone_sets_are_kept_enabled_replaced_and_deleted(tmp_path: Path) -> None:
    async with zoned(tmp_path) as it:
        sheet = it.master.last("r1", "factsheet")
        supported = ["BLOCKED", "RELEASE", "SPEED_LIMIT", "ACTION"]
        assert sheet["typeSpecification"]["supportedZones"] == supported
        offered = {a["actionType"]: a for a in sheet["protocolFeatures"]["mobileRobotActions"]}
        assert {"enableZoneSet", "deleteZoneSet", "clearZoneActions", "enableMap"} <= set(offered)
        assert "ZONE" in offered["tidy"]["actionScopes"]
        circle = [
            {"x": 20 + math.cos(n / 10_000 * math.tau), "y": math.sin(n / 10_000 * math.tau)}
            for n in range(10_000)
        ]
        await it.master.send("r1", "zoneSet", **zone_set("s1", box("z", "BLOCKED", 8, 9)))
        round_ = {"zoneId": "z", "zoneType": "BLOCKED", "vertices": circle}
        await it.master.send("r1", "zoneSet", **zone_set("s2", round_))
        await it.master.instant("r1", "enableZoneSet", "e1", zoneSetId="s1")
        await it.master.instant("r1", "deleteZoneSet", "d1", zoneSetId="s1")
        await it.master.instant("r1", "enableZoneSet", "e2", zoneSetId="s2")
        await it.master.instant("r1", "deleteZoneSet", "d2", zoneSetId="s1")
        await it.master.instant("r1", "enableZoneSet", "e3", zoneSetId="s1")
        await it.master.send("r1", "zoneSet", **zone_set("s2", box("z", "BLOCKED", 8, 9)))
        state = await it.master.until("r1", lambda s: "DUPLICATE_ZONE_SET" in kinds(s))
        assert listed(state) == [("s2", "ENABLED")]
        ended = {a["actionId"]: a["actionStatus"] for a in state["instantActionStates"]}
        assert ended == {"e1": "FINISHED", "d1": "FAILED", "e2": "FINISHED", "d2": "FINISHED", "e3": "FAILED"}  # fmt: skip
        await it.master.instant("r1", "clearInstantActions", "c1")
        state = await it.master.until("r1", lambda s: len(s["instantActionStates"]) == 1)
        assert state["maps"] == [{"mapId": "hall", "mapVersion": "1", "mapStatus": "ENABLED"}]
        await it.master.instant("r1", "enableMap", "m1", mapId="hall", mapVersion="1")
        await it.master.instant("r1", "enableMap", "m2", mapId="hall", mapVersion="2")
        await it.master.until("r1", lambda s: [a["actionStatus"] for a in s["instantActionStates"]][-2:] == ["FINISHED", "FAILED"])  # fmt: skip
        seen = await it.master.until("r1", lambda _: True, "visualization")
        assert 0 <= seen["referenceStateHeaderId"] <= it.master.last("r1")["headerId"]


def shape(*corners: tuple[float, float]) -> dict[str, Any]:
    return {"vertices": [{"x": x, "y": y} for x, y in corners]}


B = box("z", "BLOCKED", 8, 9)
WRONG: list[tuple[dict[str, Any], str, str]] = [
    (zone_set("w", B | shape((0, 0), (1, 1), (1, 0), (0, 1))), "VALIDATION_FAILURE", "crosses"),
    (zone_set("w", B | shape((0, 0), (1, 1))), "VALIDATION_FAILURE", "has 2 corners"),
    (zone_set("w", B | shape((0, 0), (math.nan, 1), (0, 1))), "VALIDATION_FAILURE", "malformed"),
    (zone_set("w", B | shape((0, 0), (1e999, 1), (0, 1))), "VALIDATION_FAILURE", ""),
    (zone_set("w", B, B), "VALIDATION_FAILURE", "two zones are z"),
    (zone_set("w", B, map_="roof"), "UNKNOWN_MAP_ID", "roof"),
    (zone_set("w", box("z", "HAUNTED", 1, 2)), "VALIDATION_FAILURE", "unknown type HAUNTED"),
    (zone_set("w", box("z", "LINE_GUIDED", 1, 2)), "VALIDATION_FAILURE", "supported are: BLOCKED"),
    (zone_set("w", box("z", "SPEED_LIMIT", 1, 2)), "VALIDATION_FAILURE", "no maximumSpeed"),
    (zone_set("w", box("z", "RELEASE", 1, 2, releaseLossBehavior="EVACUATE")), "VALIDATION_FAILURE", "EVACUATE"),
    (zone_set("w", box("z", "ACTION", 1, 2)), "VALIDATION_FAILURE", "entryActions"),
    (
        zone_set("w", box("z", "ACTION", 1, 2, entryActions=[{"actionType": "sing", "blockingType": "NONE"}], duringActions=[], exitActions=[])),
        "VALIDATION_FAILURE", "no action sing",
    ),
    (zone_set("w", B | {"vertices": [{"x": n, "y": n * n} for n in range(10_001)]}), "INSUFFICIENT_MEMORY", "10001 vertices"),
    ({"zoneSet": {"zoneSetId": "w", "zones": []}}, "VALIDATION_FAILURE", "mapId"),
]  # fmt: skip


async def test_a_wrong_zone_set_is_refused_as_a_whole(tmp_path: Path) -> None:
    async with zoned(tmp_path) as it:
        for given, kind, why in WRONG:
            await it.master.send("r1", "zoneSet", **given)
            state = await it.master.until(
                "r1",
                lambda s, kind=kind, why=why: (
                    s["errors"]
                    and s["errors"][-1]["errorType"] == kind
                    and why in s["errors"][-1]["errorDescription"]
                ),
            )
            assert state["zoneSets"] == []
        for payload in (b"", b"[]", b'{"zoneSet": 1}', b"[" * 5000):
            await it.master.send_raw("r1", "zoneSet", payload)
            await it.master.send_raw("r1", "responses", payload)
        await it.master.send("r1", "zoneSet", **zone_set("good", B))
        state = await it.master.until("r1", lambda s: s["zoneSets"])
        assert listed(state) == [("good", "DISABLED")]
        assert len(json.dumps(state)) < 20_000


async def test_a_blocked_zone_stands_against_orders_and_stops_who_is_in_it(tmp_path: Path) -> None:
    async with zoned(tmp_path) as it:
        await keep(it.master, "s1", box("wall", "BLOCKED", 9.0, 9.5))
        for places, node in (((0.0, 12.0), "n1"), ((0.0, 0.4, 9.0 - RADIUS), "n2")):
            await send_order(it, *places, id_=f"o-{node}")
            state = await it.master.until("r1", lambda s, id_=f"o-{node}": id_ in str(s["errors"]))
            fault = state["errors"][-1]
            assert (fault["errorType"], fault["errorLevel"]) == ("NO_ROUTE_TO_TARGET", "WARNING")
            assert {"referenceKey": "zoneId", "referenceValue": "wall"} in fault["errorReferences"]
            assert {"referenceKey": "nodeId", "referenceValue": node} in fault["errorReferences"]
        await send_order(it, 0.0, 8.0)
        await it.master.until("r1", lambda s: s["driving"])
        await keep(it.master, "s2", box("here", "BLOCKED", -1.0, 12.0))  # while it drives
        state = await it.master.until(
            "r1", lambda s: "BLOCKED_ZONE_VIOLATION" in kinds(s) and not s["driving"]
        )
        assert state["paused"]
        assert state["nodeStates"]
        level = next(e for e in state["errors"] if e["errorType"] == "BLOCKED_ZONE_VIOLATION")
        assert level["errorLevel"] == "CRITICAL"
        await it.master.instant("r1", "stopPause")
        await it.master.until("r1", lambda s: "NODE_UNREACHABLE" in kinds(s) and s["paused"])
        await keep(it.master, "s3")  # a set without a zone
        await it.master.until("r1", lambda s: "BLOCKED_ZONE_VIOLATION" not in kinds(s))
        await it.master.instant("r1", "stopPause")
        await it.master.until("r1", lambda s: s["driving"] and not s["errors"])


async def test_a_robot_waits_for_its_release_over_a_cut_and_gives_it_back(tmp_path: Path) -> None:
    async with zoned(tmp_path) as it:
        await keep(it.master, "s1", box("door", "RELEASE", 1.0, 1.4))
        await send_order(it, 0.0, 0.5, 2.0)
        first = await asked(it, "door")
        assert first["zoneSetId"] == "s1"
        await answer(it, first["requestId"], "QUEUED")
        it.cable.cut()
        await it.master.until("r1", lambda s: s["connectionState"] == "CONNECTION_BROKEN", "connection")  # fmt: skip
        await answer(it, first["requestId"], "GRANTED")  # which nobody hears
        await it.master.until("r1", lambda s: s["connectionState"] == "ONLINE", "connection")
        said = len(it.master.heard["r1", "state"])
        await it.master.instant("r1", "stateRequest")
        state = await it.master.until(
            "r1", lambda s: len(it.master.heard["r1", "state"]) > said and s["instantActionStates"]
        )
        assert request(state, "door", "REQUESTED") == first
        assert (state["lastNodeId"], state["driving"], state["paused"]) == ("n1", False, False)
        await answer(it, "another", "GRANTED")  # of nothing that was asked
        await answer(it, first["requestId"], "GRANTED", lease=30.0)
        await it.master.until("r1", lambda s: request(s, "door", "GRANTED"))
        state = await it.master.until("r1", done("o1", "n2"))
        assert state["zoneRequests"] == []
        assert state["errors"] == []
        for each in it.master.heard["r1", "state"]:  # it was in no zone without a grant
            assert not 1.0 - RADIUS + 0.02 < x_of(each) < 1.4 or request(each, "door", "GRANTED")


async def test_a_release_that_ends_inside_stops_the_robot_until_it_is_granted_again(
    tmp_path: Path,
) -> None:
    async with zoned(tmp_path) as it:
        await keep(it.master, "s1", box("door", "RELEASE", 0.5, 18.0))
        await send_order(it, 0.0, 20.0)
        found = await asked(it, "door")
        await answer(it, found["requestId"], "GRANTED")
        await it.master.until("r1", lambda s: s["driving"] and x_of(s) > 0.5 - RADIUS)
        await answer(it, found["requestId"], "GRANTED", lease=0.3)
        state = await it.master.until("r1", lambda s: request(s, "door", "EXPIRED"))
        assert not state["driving"]
        assert 0.5 - RADIUS < x_of(state) < 18.0
        lost = state["errors"][-1]
        assert (lost["errorType"], lost["errorLevel"]) == ("RELEASE_LOST", "CRITICAL")
        assert {"referenceKey": "zoneId", "referenceValue": "door"} in lost["errorReferences"]
        await answer(it, found["requestId"], "GRANTED", lease=-5.0)  # a clock that is not set
        state = await it.master.until("r1", lambda s: "VALIDATION_FAILURE" in kinds(s))
        assert not state["driving"]
        await answer(it, found["requestId"], "GRANTED")
        state = await it.master.until("r1", lambda s: s["driving"])
        assert "RELEASE_LOST" not in kinds(state)
        await answer(it, found["requestId"], "REVOKED")
        state = await it.master.until("r1", lambda s: request(s, "door", "REVOKED"))
        assert not state["driving"]
        await it.master.instant("r1", "cancelOrder")
        state = await it.master.until("r1", lambda s: not s["nodeStates"])
        assert request(state, "door", "REVOKED")  # it still stands there
        for each in it.master.heard["r1", "state"]:  # told only when it stood
            assert not each["driving"] or request(each, "door", "GRANTED") or not each["zoneRequests"]  # fmt: skip


async def test_a_release_that_ends_before_the_zone_needs_a_new_request(tmp_path: Path) -> None:
    async with zoned(tmp_path) as it:
        await keep(it.master, "s1", box("door", "RELEASE", 9.0, 9.4))
        await send_order(it, 0.0, 12.0)
        first = await asked(it, "door")
        await answer(it, first["requestId"], "GRANTED")
        await it.master.until("r1", lambda s: s["driving"])
        await answer(it, first["requestId"], "REVOKED")
        second = await asked(it, "door")
        state = it.master.last("r1")
        assert second["requestId"] != first["requestId"]
        assert not state["driving"]
        assert x_of(state) < 9.0 - RADIUS
        assert state["errors"] == []
        await answer(it, second["requestId"], "REJECTED")
        state = await it.master.until("r1", lambda s: s["paused"])
        assert (kinds(state), state["zoneRequests"]) == (["NODE_UNREACHABLE"], [])
        await it.master.instant("r1", "stopPause")
        third = await asked(it, "door")
        await it.master.instant("r1", "cancelOrder")
        state = await it.master.until("r1", lambda s: not s["nodeStates"])
        assert state["zoneRequests"] == []
        await answer(it, third["requestId"], "GRANTED")  # too late
        before = len(await drives(it))
        await it.master.instant("r1", "stateRequest", "late")
        state = await it.master.until("r1", lambda s: "late" in str(s["instantActionStates"]))
        assert state["zoneRequests"] == []
        assert len(await drives(it)) == before


async def test_a_zone_set_is_replaced_during_an_order(tmp_path: Path) -> None:
    going_on = {"releaseLossBehavior": "CONTINUE"}
    async with zoned(tmp_path) as it:
        await keep(it.master, "s1", box("door", "RELEASE", 0.5, 1.6, **going_on))
        await send_order(it, 0.0, 1.2, 2.8, released=2)
        found = await asked(it, "door")
        await answer(it, found["requestId"], "GRANTED")
        await it.master.until("r1", lambda s: x_of(s) > 0.5 - RADIUS and s["driving"])
        await answer(it, found["requestId"], "REVOKED")
        state = await it.master.until("r1", lambda s: request(s, "door", "REVOKED"))
        assert "RELEASE_LOST" not in kinds(state)
        await it.master.until("r1", lambda s: s["lastNodeId"] == "n1")  # it goes on
        await keep(it.master, "s2", box("gate", "RELEASE", 2.0, 2.2))
        await send_order(it, 1.2, 2.8, first=1, update=1)
        other = await asked(it, "gate")
        state = it.master.last("r1")
        assert [each["zoneSetId"] for each in state["zoneRequests"]] == ["s2"]
        assert not state["driving"]
        await answer(it, other["requestId"], "GRANTED")
        state = await it.master.until("r1", done("o1", "n2"))
        assert (state["zoneRequests"], state["errors"]) == ([], [])


async def test_a_speed_limit_holds_on_the_way_through_its_zone(tmp_path: Path) -> None:
    async with zoned(tmp_path) as it:
        slow = box("slow", "SPEED_LIMIT", 0.7, 0.8, maximumSpeed=0.3)
        slower = box("slower", "SPEED_LIMIT", 0.75, 0.8, maximumSpeed=0.2)
        await keep(it.master, "s1", slow, slower)
        await send_order(it, 0.0, 0.4, 0.9, speed=0.6)
        await it.master.until("r1", done("o1", "n2"))
        seen = it.master.heard["r1", "visualization"]
        speeds = [
            (each["mobileRobotPosition"]["x"], each["velocity"]["vx"])
            for each in seen
            if "velocity" in each
        ]
        assert max(v for x, v in speeds if x > 0.46) <= 0.2 + 0.02
        assert max(v for _, v in speeds) > 0.25


async def test_actions_of_a_zone_run_on_entering_inside_and_on_leaving(tmp_path: Path) -> None:
    def act(kind: str, blocking: str) -> dict[str, Any]:
        return {"actionType": kind, "blockingType": blocking}

    async with zoned(tmp_path) as it:
        zone = box(
            "bay", "ACTION", 0.5, 0.9, entryActions=[act("tidy", "HARD")],
            duringActions=[], exitActions=[act("tidy", "NONE")],
        )  # fmt: skip
        await keep(it.master, "s1", zone)
        await send_order(it, 0.0, 1.4)
        state = await it.master.until(
            "r1", lambda s: done("o1", "n1")(s) and len(s["zoneActionStates"]) == 2
        )
        state = await it.master.until(
            "r1", lambda s: {a["actionStatus"] for a in s["zoneActionStates"]} == {"FINISHED"}
        )
        assert state["errors"] == []
        assert len(await drives(it)) == 2  # it stood still for the first action
        await it.master.instant("r1", "clearZoneActions")
        await it.master.until("r1", lambda s: s["zoneActionStates"] == [])


async def test_a_zone_set_is_enabled_at_a_node_and_not_on_an_edge(tmp_path: Path) -> None:
    def enable(id_: str, set_: str) -> dict[str, Any]:
        parameters = [{"key": "zoneSetId", "value": set_}]
        return {
            "actionType": "enableZoneSet", "actionId": id_, "blockingType": "HARD", "actionParameters": parameters,
        }  # fmt: skip

    async with zoned(tmp_path) as it:
        await it.master.send("r1", "zoneSet", **zone_set("s1", box("z", "BLOCKED", 8, 9)))
        given = order("o1", count=2)
        given["nodes"][1]["nodePosition"]["x"] = 0.4
        given["nodes"][1]["actions"] = [enable("a1", "s1"), enable("a2", "gone")]
        names = ("orderId", "orderUpdateId", "nodes", "edges")
        wrong = json.loads(json.dumps(given))
        wrong["edges"][0]["actions"], wrong["nodes"][1]["actions"] = [enable("a1", "s1")], []
        await it.master.send("r1", "order", **{name: wrong[name] for name in names})
        await it.master.until("r1", lambda s: "INVALID_ORDER_ACTION" in kinds(s))
        await it.master.send("r1", "order", **{name: given[name] for name in names})
        state = await it.master.until("r1", lambda s: "ACTION_FAILURE" in kinds(s))
        assert listed(state) == [("s1", "ENABLED")]
        ended = {a["actionId"]: a["actionStatus"] for a in state["actionStates"]}
        assert ended == {"a1": "FINISHED", "a2": "FAILED"}
        offered = it.master.last("r1", "factsheet")["protocolFeatures"]["mobileRobotActions"]
        scopes = {each["actionType"]: each["actionScopes"] for each in offered}
        assert scopes["enableZoneSet"] == scopes["enableMap"] == ["INSTANT", "NODE"]
        assert scopes["deleteZoneSet"] == ["INSTANT"]
