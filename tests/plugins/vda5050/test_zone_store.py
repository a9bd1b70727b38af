"""Zone sets outlive the gateway: after a kill, with damaged rows, and with a disk that is full."""

from __future__ import annotations

import asyncio
import os
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from configuration import backend, key, listener, table
from durability.process import Served
from plugins.vda5050.broker import MOSQUITTO, broker, master
from plugins.vda5050.test_robot import MANAGER, depot, robots
from plugins.vda5050.test_zones import SIZE, kinds, send_order
from plugins.vda5050.zones import box, check_state, keep, listed, zone_set
from rcp_store.file import open_writable

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(
        MOSQUITTO is None and not os.environ.get("RCP_CI"), reason="needs Mosquitto"
    ),
]
WALL = box("wall", "BLOCKED", 9.0, 9.5)


class Sender:
    """What `send_order` needs of a depot."""

    def __init__(self, manager: Any) -> None:
        self.master = manager


async def refused(it: Any, kind: str, id_: str = "o1") -> dict[str, Any]:
    """Send an order through the wall; return the error that refuses it."""
    await send_order(it, 0.0, 12.0, id_=id_)
    state = await it.master.until("r1", lambda s: id_ in str(s["errors"]))
    found = next(e for e in state["errors"] if id_ in str(e["errorReferences"]))
    assert found["errorType"] == kind
    assert (state["orderId"], state["driving"]) == ("", False)
    return found


async def test_zones_hold_after_a_kill_before_the_first_order(tmp_path: Path) -> None:
    async with broker(tmp_path) as port, master(port, "3.0") as manager:
        text = listener() + backend("rover1", tenant="r1", use="sim", world={"width": 60.0, "height": 60.0})  # fmt: skip
        text += key("manager", MANAGER, role="operator") + robots(1, "3.0", port) + SIZE
        served = await asyncio.to_thread(Served, tmp_path, tmp_path / "store.db", text)
        try:
            await manager.until("r1", lambda s: "mobileRobotPosition" in s)
            await manager.send("r1", "zoneSet", **zone_set("spare"))
            await keep(manager, "gone")
            await manager.send("r1", "zoneSet", **zone_set("s1", WALL))
            await manager.instant("r1", "enableZoneSet", "e1", zoneSetId="s1")
            await manager.instant("r1", "deleteZoneSet", "d1", zoneSetId="gone")
            done = {"e1": "FINISHED", "d1": "FINISHED"}
            await manager.until(
                "r1",
                lambda s: (
                    done.items()
                    <= {a["actionId"]: a["actionStatus"] for a in s["instantActionStates"]}.items()
                ),
            )
            served.kill()
            manager.heard.clear()
            served = await asyncio.to_thread(Served, tmp_path, tmp_path / "store.db", text)
            state = await manager.until("r1", lambda s: "mobileRobotPosition" in s)
            assert sorted(listed(state)) == [("s1", "ENABLED"), ("spare", "DISABLED")]
            first = manager.heard["r1", "state"][0]
            assert ("s1", "ENABLED") in listed(first)
            await refused(Sender(manager), "NO_ROUTE_TO_TARGET")
        finally:
            served.kill()


def spoil(path: Path, part: str, change: Any) -> None:
    """Change the rows of the store whose key has a part."""
    with closing(sqlite3.connect(path)) as base, base:
        where = "place = 'vda5050.zones' AND key LIKE ?"
        rows = base.execute(f"SELECT key, value FROM kept WHERE {where}", (f"%{part}",)).fetchall()
        assert rows
        for name, value in rows:
            base.execute("UPDATE kept SET value = ? WHERE key = ?", (change(value), name))


@pytest.mark.parametrize(
    ("part", "change", "lost"),
    [
        ('"s1"]', lambda value: value.replace(b"BLOCKED", b"ACTIONS"), "s1"),
        ('"s1"]', lambda _: b"\xc1", "s1"),
        ('"hall"]', lambda _: b"\xc1", "?"),
    ],
    ids=["changed", "unreadable", "which"],
)
async def test_a_damaged_row_of_the_zones_in_force_lets_no_order_pass(
    tmp_path: Path, part: str, change: Any, lost: str
) -> None:
    path = tmp_path / "store.db"
    more = SIZE + table("store", path=path)
    async with depot(tmp_path, version="3.0", more=more) as it:
        await it.master.send("r1", "zoneSet", **zone_set("spare", WALL))
        await keep(it.master, "s1", WALL)
        await it.master.instant("r1", "stateRequest", "last")
        await it.master.until("r1", lambda s: "last" in str(s["instantActionStates"]))
    spoil(path, part, change)
    async with depot(tmp_path, version="3.0", more=more) as it:
        state = await it.master.until("r1", lambda s: s["errors"])
        assert ("spare", "DISABLED") in listed(state)
        assert "ENABLED" not in str(state["zoneSets"])
        [fault] = state["errors"]
        assert (fault["errorType"], fault["errorLevel"]) == ("ZONES_NOT_KNOWN", "FATAL")
        assert {"referenceKey": "zoneSetId", "referenceValue": lost} in fault["errorReferences"]
        assert "deleteZoneSet" in fault["errorHint"]
        await refused(it, "ZONES_NOT_KNOWN")
        if lost == "?":
            await it.master.instant("r1", "enableZoneSet", zoneSetId="s1")
        else:  # it may be sent again, and that alone does not put it in force
            await it.master.send("r1", "zoneSet", **zone_set("s1", WALL))
            await it.master.until("r1", lambda s: ("s1", "DISABLED") in listed(s))
            await refused(it, "ZONES_NOT_KNOWN", "o2")
            await it.master.instant("r1", "deleteZoneSet", zoneSetId="s1")
            await it.master.until("r1", lambda s: len(s["zoneSets"]) == 1)
            await it.master.instant("r1", "enableZoneSet", zoneSetId="spare")
        await it.master.until("r1", lambda s: "ENABLED" in str(s["zoneSets"]))
        await refused(it, "NO_ROUTE_TO_TARGET", "o3")
        await send_order(it, 0.0, 0.4, id_="o4")
        state = await it.master.until("r1", lambda s: s["orderId"] == "o4" and not s["nodeStates"])
        assert state["errors"] == []
        for each in it.master.heard["r1", "state"]:
            check_state(each)


async def test_a_set_that_is_sent_again_is_not_in_force_after_a_restart_either(
    tmp_path: Path,
) -> None:
    path = tmp_path / "store.db"
    more = SIZE + table("store", path=path)
    async with depot(tmp_path, version="3.0", more=more) as it:
        await keep(it.master, "s1", WALL)
    spoil(path, '"s1"]', lambda _: b"\xc1")
    async with depot(tmp_path, version="3.0", more=more) as it:
        await it.master.send("r1", "zoneSet", **zone_set("s1"))  # without the wall
        await it.master.until("r1", lambda s: ("s1", "DISABLED") in listed(s))
    async with depot(tmp_path, version="3.0", more=more) as it:
        assert listed(it.master.last("r1")) == [("s1", "DISABLED")]
        fault = await refused(it, "ZONES_NOT_KNOWN")
        assert "it is there again, and not enabled" in fault["errorDescription"]
        await it.master.instant("r1", "enableZoneSet", zoneSetId="s1")
        await it.master.until("r1", lambda s: ("s1", "ENABLED") in listed(s))
    async with depot(tmp_path, version="3.0", more=more) as it:
        assert listed(it.master.last("r1")) == [("s1", "ENABLED")]
        await send_order(it, 0.0, 0.4)
        await it.master.until("r1", lambda s: s["orderId"] == "o1" and not s["nodeStates"])


async def test_zones_hold_while_the_disk_is_full_and_the_state_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limited = True

    def small(path: Path) -> sqlite3.Connection:
        base = open_writable(path)
        base.execute(f"PRAGMA max_page_count = {30 if limited else 9999}")
        return base

    monkeypatch.setattr("rcp_store.disk_store.open_writable", small)
    round_ = [{"x": 20 + n / 10_000, "y": (n - 5000) ** 2 / 1e7} for n in range(4000)]
    big = {"zoneId": "z", "zoneType": "BLOCKED", "vertices": round_}
    more = SIZE + table("store", path=tmp_path / "store.db")
    async with depot(tmp_path, version="3.0", more=more) as it:
        await keep(it.master, "s1", WALL, big)
        state = await it.master.until("r1", lambda s: "ZONE_SET_NOT_STORED" in kinds(s))
        assert state["errors"][-1]["errorLevel"] == "URGENT"
        await refused(it, "NO_ROUTE_TO_TARGET")
        limited = False  # somebody made room
        await it.master.until("r1", lambda s: "ZONE_SET_NOT_STORED" not in kinds(s))
    async with depot(tmp_path, version="3.0", more=more) as it:
        state = await it.master.until("r1", lambda s: s["zoneSets"])
        assert (listed(state), state["errors"]) == ([("s1", "ENABLED")], [])


async def test_sets_wait_for_their_map_and_for_the_version_that_has_zones(tmp_path: Path) -> None:
    more = SIZE + table("store", path=tmp_path / "store.db")
    async with depot(tmp_path, version="3.0", more=more) as it:
        await keep(it.master, "s1", WALL)
    async with depot(tmp_path, version="3.0", more=more, map="roof") as it:
        assert it.master.last("r1")["zoneSets"] == []
    async with depot(tmp_path, version="2.1", more=more) as it:
        await send_order(it, 0.0, 9.0)
        await it.master.until("r1", lambda s: s["driving"])
    async with depot(tmp_path, version="3.0", more=more) as it:
        assert listed(it.master.last("r1")) == [("s1", "ENABLED")]
