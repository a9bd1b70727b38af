"""Simulated rovers at a real broker: orders driven, paused, cancelled, stopped, and told of."""

from __future__ import annotations

import asyncio
import json
import os
import threading
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import MQTTMessage

from configuration import backend, configuration, key, table
from plugins.vda5050.broker import BOUND, MOSQUITTO, Cable, Master, broker, cable, master
from plugins.vda5050.test_orders import action, order
from rcp_gateway.testing import Client, serve
from rcp_kernel.config.file import parse
from rcp_vda5050.link import Link, NotStoppedError, Running
from rcp_vda5050.robots import Client as RobotClient

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(
        MOSQUITTO is None and not os.environ.get("RCP_CI"), reason="needs Mosquitto"
    ),
]
MANAGER, PERSON, ADMIN = (
    f"a-key-of-the-{who}-that-is-long" for who in ("manager", "person", "admin")
)
STEP = 0.4  # m between two nodes: half a second


class Depot:
    """A gateway with rovers, their broker, the fleet manager, and a person at the gateway."""

    def __init__(self, served: Any, master: Master, cable: Cable) -> None:
        self.served, self.master, self.cable = served, master, cable
        self.admin: Client = served.client(ADMIN)

    async def estop(self, **body: Any) -> None:
        reply = await self.admin.request("execute", "/system/estop", body=body, within=60.0)
        assert reply["status"] == "completed", reply

    async def pose(self, tenant: str = "r1") -> tuple[float, float]:
        reply = await self.admin.request("read", f"/tenant/{tenant}/sensor/pose")
        position = reply["body"]["position"]
        return position["x"], position["y"]


def robots(count: int, version: str, port: int, **more: Any) -> str:
    text = table("plugins.vda5050", broker=f"mqtt://127.0.0.1:{port}", visualization=2.0)
    for n in range(1, count + 1):
        text += table(
            f"plugins.vda5050.robots.r{n}", robot=f"/tenant/r{n}", token=MANAGER,
            manufacturer="acme", serial=f"r{n}", version=version, **{"map": "hall", "tolerance": 0.1, **more},
        )  # fmt: skip
        for name, path in (("dock", "action/dock"), ("tidy", "service/clear_faults")):
            text += table(f"plugins.vda5050.robots.r{n}.actions.{name}", path=path)
    return text


@asynccontextmanager
async def depot(
    folder: Path, count: int = 1, version: str = "2.1", more: str = "", **robot: Any
) -> AsyncGenerator[Depot]:
    """Run it all."""
    async with broker(folder) as port, cable(port) as wire, master(port, version) as manager:
        text = configuration(
            *(
                backend(f"rover{n}", tenant=f"r{n}", use="sim", seed=n, rate=20.0, world={"width": 60.0, "height": 60.0})
                for n in range(1, count + 1)
            ),
            key("manager", MANAGER, role="operator"),
            key("person", PERSON, role="operator"),
            key("admin", ADMIN),
            robots(count, version, wire.port, **robot) + more,
        )  # fmt: skip
        async with serve(parse(text, "test")) as served:
            for n in range(1, count + 1):
                await manager.until(f"r{n}", online, "connection")
                name = "agvPosition" if version == "2.1" else "mobileRobotPosition"
                await manager.until(f"r{n}", lambda it, name=name: name in it)
            yield Depot(served, manager, wire)


def online(connection: dict[str, Any]) -> bool:
    return connection["connectionState"] == "ONLINE"


def near(given: dict[str, Any]) -> dict[str, Any]:
    """Bring the nodes of an order close together."""
    for node in given["nodes"]:
        node["nodePosition"]["x"] *= STEP
    return {k: v for k, v in given.items() if k in ("orderId", "orderUpdateId", "nodes", "edges")}


def done(id_: str, node: str) -> Any:
    """Tell whether an order has ended at a node."""
    return lambda it: (
        it["orderId"] == id_
        and it["lastNodeId"] == node
        and not it["nodeStates"]
        and not it["driving"]
    )


@pytest.mark.parametrize("version", ["2.1", "3.0"])
async def test_an_order_is_driven_and_told_of(tmp_path: Path, version: str) -> None:
    async with depot(tmp_path, version=version) as it:
        given = near(order())
        given["nodes"][1]["actions"] = [action("a1", "tidy")]
        await it.master.send("r1", "order", **given)
        state = await it.master.until("r1", done("o1", "n2"))
        assert state["errors"] == []
        assert [(a["actionId"], a["actionStatus"]) for a in state["actionStates"]] == [
            ("a1", "FINISHED")
        ]
        assert (await it.pose())[0] == pytest.approx(2 * STEP, abs=0.12)
        heard = it.master.heard["r1", "state"]
        assert [each["headerId"] for each in heard] == list(range(len(heard)))
        reached = [each["lastNodeId"] for each in heard if each["lastNodeId"]]
        assert list(dict.fromkeys(reached)) == ["n0", "n1", "n2"]
        assert any(each["driving"] for each in heard)
        if version == "3.0":
            assert state["safetyState"]["activeEmergencyStop"] == "NONE"
            assert state["powerSupply"]["stateOfCharge"] > 50
            assert state["mobileRobotPosition"]["localized"]
        else:
            assert state["safetyState"]["eStop"] == "NONE"
            assert state["batteryState"]["batteryCharge"] > 50
            assert state["agvPosition"]["positionInitialized"]
        seen = it.master.heard["r1", "visualization"][-1]
        assert (seen.get("agvPosition") or seen["mobileRobotPosition"])["mapId"] == "hall"
        sheet = it.master.last("r1", "factsheet")
        offered = sheet["protocolFeatures"][
            "agvActions" if version == "2.1" else "mobileRobotActions"
        ]
        assert {"cancelOrder", "dock", "tidy"} <= {each["actionType"] for each in offered}


async def test_the_horizon_waits_for_its_release(tmp_path: Path) -> None:
    async with depot(tmp_path) as it:
        await it.master.send("r1", "order", **near(order(released=2)))
        state = await it.master.until("r1", lambda s: s["lastNodeId"] == "n1" and not s["driving"])
        assert [(n["nodeId"], n["released"]) for n in state["nodeStates"]] == [("n2", False)]
        await it.master.send("r1", "order", **near(order(update=1, first=1, count=3)))
        state = await it.master.until("r1", done("o1", "n3"))
        assert state["orderUpdateId"] == 1


async def test_a_pause_stops_and_the_order_goes_on_after_it(tmp_path: Path) -> None:
    async with depot(tmp_path) as it:
        given = near(order(count=2))
        given["nodes"][1]["nodePosition"]["x"] = 3.0
        await it.master.send("r1", "order", **given)
        await it.master.until("r1", lambda s: s["driving"])
        id_ = await it.master.instant("r1", "startPause")
        state = await it.master.until("r1", lambda s: s["paused"] and not s["driving"])
        assert ("FINISHED", id_) in [
            (a["actionStatus"], a["actionId"]) for a in state["actionStates"]
        ]
        assert (await it.pose())[0] < 2.5
        await it.master.instant("r1", "stopPause")
        await it.master.until("r1", done("o1", "n1"))


async def test_a_cancelled_order_has_ended_when_the_action_has(tmp_path: Path) -> None:
    async with depot(tmp_path) as it:
        given = near(order(count=3))
        given["nodes"][1]["nodePosition"]["x"] = 3.0
        given["nodes"][2]["actions"] = [action("a1", "dock")]
        await it.master.send("r1", "order", **given)
        await it.master.until("r1", lambda s: s["driving"])
        id_ = await it.master.instant("r1", "cancelOrder")

        def over(state: dict[str, Any]) -> bool:
            states = {a["actionId"]: a["actionStatus"] for a in state["actionStates"]}
            return states.get(id_) == "FINISHED"

        state = await it.master.until("r1", over)
        assert (state["nodeStates"], state["edgeStates"], state["driving"]) == ([], [], False)
        assert {"actionId": "a1", "actionType": "dock", "actionStatus": "FAILED"} in state[
            "actionStates"
        ]
        again = await it.master.instant("r1", "cancelOrder")
        state = await it.master.until("r1", lambda s: any(a["actionId"] == again and a["actionStatus"] == "FAILED" for a in s["actionStates"]))  # fmt: skip
        assert state["errors"][-1]["errorType"] == "noOrderToCancel"
        x, _ = await it.pose()
        more = near(order("o2", count=1))
        more["nodes"][0]["nodePosition"]["x"] = x
        await it.master.send("r1", "order", **more)
        await it.master.until("r1", done("o2", "n0"))


async def test_an_estop_pauses_and_nothing_moves_after_its_reset_until_it_is_told(
    tmp_path: Path,
) -> None:
    async with depot(tmp_path) as it:
        given = near(order(count=2))
        given["nodes"][1]["nodePosition"]["x"] = 3.0
        await it.master.send("r1", "order", **given)
        await it.master.until("r1", lambda s: s["driving"])
        await it.estop()
        state = await it.master.until(
            "r1", lambda s: s["safetyState"]["eStop"] == "REMOTE" and not s["driving"]
        )
        assert state["paused"]
        assert [e["errorLevel"] for e in state["errors"]] == ["FATAL"]
        at = await it.pose()
        await it.estop(reset=True)
        state = await it.master.until("r1", lambda s: s["safetyState"]["eStop"] == "NONE")
        assert state["paused"]
        assert await it.pose() == pytest.approx(at, abs=0.02)
        await it.master.instant("r1", "stopPause")
        state = await it.master.until("r1", done("o1", "n1"))
        assert state["errors"] == []


@pytest.mark.parametrize("how", ["pause", "estop"])
async def test_a_paused_order_that_is_cancelled_moves_nothing(tmp_path: Path, how: str) -> None:
    async with depot(tmp_path) as it:
        given = near(order(count=3))
        given["nodes"][1]["nodePosition"]["x"] = 3.0
        await it.master.send("r1", "order", **given)
        await it.master.until("r1", lambda s: s["driving"])
        if how == "pause":
            await it.master.instant("r1", "startPause")
        else:
            await it.estop()
        await it.master.until("r1", lambda s: s["paused"] and not s["driving"])
        if how == "estop":
            await it.estop(reset=True)
            await it.master.until("r1", lambda s: s["safetyState"]["eStop"] == "NONE")
        before = len(await drives(it))
        id_ = await it.master.instant("r1", "cancelOrder")
        state = await it.master.until("r1", ended(id_))
        assert (state["nodeStates"], state["paused"], state["driving"]) == ([], False, False)
        await it.master.send("r1", "order", **near(order(update=1, first=1)))  # too late
        state = await it.master.until("r1", lambda s: s["errors"])
        assert state["errors"][-1]["errorType"] == "orderUpdateError"
        assert len(await drives(it)) == before
        assert await leases(it) == []


async def test_a_cancel_that_the_robot_does_not_confirm_is_not_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with depot(tmp_path) as it:
        given = near(order(count=2))
        given["nodes"][1]["nodePosition"]["x"] = 3.0
        await it.master.send("r1", "order", **given)
        await it.master.until("r1", lambda s: s["driving"])

        async def not_confirmed(_running: Running) -> None:
            raise NotStoppedError("the link is lost")

        monkeypatch.setattr(Running, "_see_end", not_confirmed)
        id_ = await it.master.instant("r1", "cancelOrder")
        state = await it.master.until(
            "r1",
            lambda s: (
                ("FAILED", id_) in [(a["actionStatus"], a["actionId"]) for a in s["actionStates"]]
            ),
        )
        assert state["errors"][-1]["errorType"] == "robotNotAvailable"


async def test_pauses_in_quick_succession_are_no_fault(tmp_path: Path) -> None:
    async with depot(tmp_path) as it:
        given = near(order(count=2))
        given["nodes"][1]["nodePosition"]["x"] = 2.0
        await it.master.send("r1", "order", **given)
        await it.master.until("r1", lambda s: s["driving"])
        for _ in range(3):
            await it.master.instant("r1", "startPause")
            last = await it.master.instant("r1", "stopPause")
        await it.master.until("r1", ended(last))
        state = await it.master.until("r1", done("o1", "n1"))
        assert state["errors"] == []


async def test_an_estop_during_an_action_leaves_the_rest_of_the_order_waiting(
    tmp_path: Path,
) -> None:
    async with depot(tmp_path) as it:
        given = near(order(count=2))
        given["nodes"][0]["nodePosition"]["x"] = 0.9
        given["nodes"][1]["nodePosition"]["x"] = 1.8
        given["nodes"][1]["actions"] = [action("a1", "dock"), action("a2", "tidy")]
        given["nodes"][1]["nodePosition"]["allowedDeviationXY"] = 0.1
        await it.master.send("r1", "order", **given)

        def running(state: dict[str, Any]) -> bool:
            return statuses(state) == {"a1": "RUNNING", "a2": "WAITING"}

        await it.master.until("r1", running)
        await it.estop()
        state = await it.master.until("r1", lambda s: statuses(s)["a1"] == "FAILED")
        assert statuses(state)["a2"] == "WAITING"
        assert state["paused"]
        await it.estop(reset=True)
        await it.master.until("r1", lambda s: s["safetyState"]["eStop"] == "NONE")
        await it.master.instant("r1", "stopPause")
        await it.master.until("r1", lambda s: statuses(s)["a2"] == "FINISHED")


async def test_a_last_action_that_somebody_stops_holds_no_later_order_up(tmp_path: Path) -> None:
    async with depot(tmp_path) as it:
        given = near(order(count=2))
        given["nodes"][1]["nodePosition"]["x"] = 0.9
        given["nodes"][1]["actions"] = [action("a1", "dock")]
        await it.master.send("r1", "order", **given)
        await it.master.until("r1", lambda s: statuses(s) == {"a1": "RUNNING"})
        await it.admin.request("cancel", "/tenant/r1/action/dock")
        state = await it.master.until("r1", lambda s: statuses(s)["a1"] == "FAILED")
        assert not state["paused"]
        here = (await it.pose())[0]
        later = near(order("o2", count=2))
        later["nodes"][0]["nodePosition"]["x"], later["nodes"][1]["nodePosition"]["x"] = here, 0.3
        await it.master.send("r1", "order", **later)
        await it.master.until("r1", done("o2", "n1"))


async def test_an_instant_action_without_an_order_gives_control_back(tmp_path: Path) -> None:
    async with depot(tmp_path) as it:
        id_ = await it.master.instant("r1", "tidy")
        await it.master.instant("r1", "tidy", id_)  # a second time
        await it.master.until("r1", ended(id_))
        assert await leases(it) == []
        tidied = [each for each in await commands(it) if each["path"].endswith("clear_faults")]
        assert len(tidied) == 1


def statuses(state: dict[str, Any]) -> dict[str, str]:
    return {
        a["actionId"]: a["actionStatus"]
        for a in state["actionStates"]
        if a["actionId"] in ("a1", "a2")
    }


def ended(id_: str) -> Any:
    """Tell whether an instant action is finished."""
    return lambda state: (
        ("FINISHED", id_) in [(a["actionStatus"], a["actionId"]) for a in state["actionStates"]]
    )


async def drives(it: Depot) -> list[dict[str, Any]]:
    return [each for each in await commands(it) if each["path"].endswith("move_to")]


async def leases(it: Depot) -> list[dict[str, Any]]:
    reply = await it.admin.request("read", "/system/leases")
    assert reply["status"] == "completed", reply
    return reply["body"]


async def test_a_person_who_takes_control_interrupts_the_order(tmp_path: Path) -> None:
    async with depot(tmp_path) as it:
        given = near(order(count=2))
        given["nodes"][1]["nodePosition"]["x"] = 3.0
        await it.master.send("r1", "order", **given)
        await it.master.until("r1", lambda s: s["driving"])
        take = {
            "do": "acquire",
            "scope": "/tenant/r1",
            "take": True,
            "reason": "a person is in the way",
        }
        reply = await it.admin.request("execute", "/system/leases", body=take)
        assert reply["status"] == "completed", reply
        state = await it.master.until(
            "r1", lambda s: s["paused"] and not s["driving"] and s["errors"]
        )
        assert state["errors"][0]["errorType"] == "robotNotAvailable"
        lease = {"do": "release", "lease": reply["body"]["lease"]}
        assert (await it.admin.request("execute", "/system/leases", body=lease))[
            "status"
        ] == "completed"
        await it.master.instant("r1", "stopPause")
        await it.master.until("r1", done("o1", "n1"))


HOSTILE = [b"", b"{", b"[]", b"null", b'{"orderId": "o9"}', b"\xff\xfe", b"[" * 5000]


async def test_what_is_wrong_is_told_once_and_the_robot_goes_on(tmp_path: Path) -> None:
    async with depot(tmp_path) as it:
        for payload in HOSTILE:
            for topic in ("order", "instantActions"):
                await it.master.send_raw("r1", topic, payload)
        other = it.master.header("r1") | order("o8") | {"serialNumber": "r2"}
        await it.master.send_raw("r1", "order", json.dumps(other).encode())
        newer = order("o8") | {"version": "3.0.0"}
        await it.master.send_raw("r1", "order", json.dumps(newer).encode())
        far = near(order("o7"))
        far["nodes"][0]["nodePosition"]["x"] = 9.0
        await it.master.send("r1", "order", **far)
        await it.master.instant("r1", "dance", "d1")
        state = await it.master.until(
            "r1", lambda s: [e["errorType"] for e in s["errors"]][-1:] == ["instantActionError"]
        )
        kinds = [each["errorType"] for each in state["errors"]]
        assert len(kinds) == 10  # the latest ones
        assert kinds[-2:] == ["noRouteError", "instantActionError"]
        assert set(kinds[:-2]) == {"validationError"}
        assert {"referenceKey": "orderId", "referenceValue": "o7"} in state["errors"][-2][
            "errorReferences"
        ]
        assert {a["actionId"]: a["actionStatus"] for a in state["actionStates"]} == {"d1": "FAILED"}
        await it.master.send("r1", "order", **near(order()))
        state = await it.master.until("r1", done("o1", "n2"))
        assert state["errors"] == []


async def test_a_broken_connection_is_told_by_the_last_will_and_the_base_is_driven_meanwhile(
    tmp_path: Path,
) -> None:
    async with depot(tmp_path) as it:
        await it.master.send("r1", "order", **near(order()))
        await it.master.until("r1", lambda s: s["driving"])
        it.cable.cut()
        await it.master.until(
            "r1", lambda c: c["connectionState"] == "CONNECTIONBROKEN", "connection"
        )
        await it.master.until("r1", lambda c: c["connectionState"] == "ONLINE", "connection")
        await it.master.until("r1", done("o1", "n2"))
    assert it.master.last("r1", "connection")["connectionState"] == "OFFLINE"


AMRS, ORDERS, CUTS = 10, 10, 50
TRIES = 15


@pytest.mark.paired
async def test_ten_robots_finish_a_hundred_orders_each_once_through_fifty_cuts(
    tmp_path: Path,
) -> None:
    async with depot(tmp_path, AMRS) as it:
        finished = cuts = 0
        serials = [f"r{n}" for n in range(1, AMRS + 1)]

        async def sent(serial: str, given: dict[str, Any]) -> None:
            """Send an order until the state shows it: what waits at the broker is lost with a session."""
            id_ = given["orderId"]
            for _ in range(TRIES):
                await it.master.send(serial, "order", **given)
                with suppress(TimeoutError):
                    async with asyncio.timeout(2.0):
                        await it.master.until(serial, lambda s: s["orderId"] == id_)
                    return
            raise AssertionError(
                (given, it.master.last(serial), it.master.last(serial, "connection"))
            )

        async def manage(serial: str) -> None:
            nonlocal finished, cuts
            for n in range(ORDERS):
                given = near(order(f"{serial}-{n}", count=2))
                ends = (0.0, STEP) if n % 2 == 0 else (STEP, 0.0)
                for node, x in zip(given["nodes"], ends, strict=True):
                    node["nodePosition"]["x"] = x
                given["nodes"][0]["actions"] = [action(f"{serial}-{n}-a", "tidy")]
                await sent(serial, given)
                state = await it.master.until(serial, done(f"{serial}-{n}", "n1"))
                assert state["errors"] == [], state
                finished += 1
                if finished % (AMRS * ORDERS // CUTS) == 0:
                    for (
                        each
                    ) in serials:  # who is cut while it dials waits longer before the next time
                        await it.master.until(each, online, "connection")
                    it.cable.cut()
                    cuts += 1

        await asyncio.gather(*map(manage, serials))
        assert cuts == CUTS
        for serial in serials:
            heard = it.master.heard[serial, "state"]
            seen = [each["orderId"] for each in heard if each["orderId"]]
            assert list(dict.fromkeys(seen)) == [f"{serial}-{n}" for n in range(ORDERS)]
            assert seen == sorted(seen, key=lambda id_: int(id_.rpartition("-")[2]))
            assert [each["headerId"] for each in heard] == sorted(h["headerId"] for h in heard)
        moved = await drives(it)
        assert len(moved) == AMRS * ORDERS  # nothing was driven twice
        assert {each["status"] for each in moved} == {"completed"}


async def commands(it: Depot) -> list[dict[str, Any]]:
    """Return the commands that the gateway knows."""
    reply = await it.admin.request("read", "/system/commands")
    assert reply["status"] == "completed", reply
    return reply["body"]


async def test_what_the_broker_has_kept_is_not_carried_out(tmp_path: Path) -> None:
    async with depot(tmp_path) as it:
        it.cable.cut()
        await it.master.send("r1", "order", kept=True, **near(order("of-yesterday")))
        told = await it.master.until("r1", lambda state: state["errors"])
        assert told["errors"][-1]["errorType"] == "validationError"
        assert "kept by the broker" in told["errors"][-1]["errorDescription"]
        assert told["orderId"] == ""


async def test_of_what_the_broker_has_kept_the_robot_is_stopped_at_most(tmp_path: Path) -> None:
    async with depot(tmp_path) as it:
        it.cable.cut()
        kinds = ("startPause", "dock", "cancelOrder")
        actions = [action(f"kept-{kind}", kind) for kind in kinds]
        await it.master.send("r1", "instantActions", kept=True, actions=actions)
        told = await it.master.until(
            "r1", lambda it: it["paused"] and [e for e in it["errors"] if "kept by" in _text(e)]
        )
        assert any("only startPause, cancelOrder of it" in _text(e) for e in told["errors"])
        states = told.get("actionStates", []) + told.get("instantActionStates", [])
        assert "kept-dock" not in {each["actionId"] for each in states}


def _text(error: dict[str, Any]) -> str:
    return error["errorDescription"]


@pytest.fixture
def clients(monkeypatch: pytest.MonkeyPatch) -> list[RobotClient]:
    """Return the robots that are at the broker."""
    found: list[RobotClient] = []
    open_ = RobotClient.open

    async def seen(client: RobotClient, rows: Any) -> None:
        found.append(client)
        await open_(client, rows)

    monkeypatch.setattr(RobotClient, "open", seen)
    return found


def _receive(client: RobotClient, topic: str, payload: bytes) -> None:
    """Have it receive a message at once, while the event loop does something else."""
    message = MQTTMessage(topic=f"uagv/v2/acme/r1/{topic}".encode())
    message.payload = payload
    client._received(client._mqtt, None, message)  # noqa: SLF001 - as its thread does


async def test_messages_that_are_dropped_are_told_and_a_pause_is_taken(
    tmp_path: Path, clients: list[RobotClient], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_vda5050.robots._QUEUED", 8)
    async with depot(tmp_path) as it:
        (client,) = clients
        refused: list[str] = []
        refuse = client.robot.refuse_dropped
        monkeypatch.setattr(
            client.robot, "refuse_dropped", lambda topic: (refused.append(topic), refuse(topic))
        )
        for _ in range(20):
            _receive(client, "order", b"{}")
        pause = {"actions": [action("p", "startPause")]}
        _receive(client, "instantActions", json.dumps(it.master.header("r1") | pause).encode())
        told = await it.master.until(
            "r1", lambda it: it["paused"] and any("dropped" in _text(e) for e in it["errors"])
        )
        assert told["errors"][-1]["errorReferences"][0]["referenceValue"] == "order"
        assert refused == ["order"]
        for _ in range(9):
            _receive(client, "order", b"{}")
        await asyncio.sleep(0)
        await it.master.until("r1", lambda _: refused == ["order", "order"])


async def test_a_message_that_is_too_large_is_told(
    tmp_path: Path, clients: list[RobotClient]
) -> None:
    async with depot(tmp_path) as it:
        _receive(clients[0], "order", bytes(17 << 20))
        told = await it.master.until("r1", lambda it: it["errors"])
        assert f"{17 << 20} bytes are too many" in _text(told["errors"][-1])


async def test_a_look_at_the_estop_that_fails_is_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_vda5050.robot._LOOK_AGAIN", 0.05)
    async with depot(tmp_path) as it:
        send, failed = Link.send, list[str]()

        def failing(link: Link, type_: str, path: str | None, *rest: Any, **more: Any) -> Running:
            if path != "/system/robots" or len(failed) == 2:
                return send(link, type_, path, *rest, **more)
            failed.append(path)
            running = Running(link, None)
            running.hear({"status": "failed", "error": {"code": "internal", "message": "no"}})
            return running

        monkeypatch.setattr(Link, "send", failing)
        await it.estop()
        await it.master.until("r1", lambda it: it["safetyState"]["eStop"] == "REMOTE")
        assert len(failed) == 2
        await it.estop(reset=True)


async def test_a_robot_that_leaves_while_it_connects_again_is_gone_at_once(
    tmp_path: Path, clients: list[RobotClient], monkeypatch: pytest.MonkeyPatch
) -> None:
    async with depot(tmp_path) as it:
        (client,) = clients
        mqtt = client._mqtt  # noqa: SLF001 - the race is in its thread
        connecting, leaving = threading.Event(), threading.Event()
        stop = mqtt.loop_stop

        def pause(*_: Any) -> None:
            connecting.set()
            leaving.wait(BOUND)

        def stopping() -> Any:
            leaving.set()
            return stop()

        mqtt.on_pre_connect = pause
        monkeypatch.setattr(mqtt, "loop_stop", stopping)
        it.cable.cut()
        assert await asyncio.to_thread(connecting.wait, BOUND)
        heard = it.master.heard["r1", "connection"]
        wills = [each["connectionState"] for each in heard].count("CONNECTIONBROKEN")
        await client.close()
        assert mqtt.socket() is None
        await it.master.send("r1", "state", marker=True)  # what the broker has to say comes before
        await it.master.until("r1", lambda it: "marker" in it)
        states = [each["connectionState"] for each in heard]
        assert states.count("CONNECTIONBROKEN") == max(wills, 1), states  # that of the cut
