"""Plan files of QGroundControl and Mission Planner: loaded as a whole or not at all, exported, equal."""

from __future__ import annotations

import json
import math
from collections.abc import AsyncIterator
from typing import Any

import pytest

from backends.mavlink.puppet import PX4, Puppet, station
from backends.mavlink.test_gateway import LAT, LON, Pilot, flying
from rcp_mavlink.dialect import dialect
from rcp_mavlink.messages import Item
from rcp_mavlink.plan_files import Names, parsed
from rcp_mavlink.plans import FENCE, MISSION


def simple(command: int, *params: float | None, frame: int = 3) -> dict[str, Any]:
    return {
        "type": "SimpleItem", "command": command, "frame": frame, "params": list(params), "autoContinue": True, "doJumpId": 1,
    }  # fmt: skip


SURVEY = {
    "type": "ComplexItem",
    "complexItemType": "survey",
    "TransectStyleComplexItem": {
        "Items": [
            simple(16, 0, 0, 0, None, LAT + 3e-4, LON, 12),
            simple(206, 5, 0, 1, 0, 0, 0, 0, frame=2),
            simple(16, 0, 0, 0, None, LAT + 3e-4, LON + 2e-4, 12),
        ]
    },
}
PLAN: dict[str, Any] = {
    "fileType": "Plan",
    "version": 1,
    "groundStation": "QGroundControl",
    "mission": {
        "version": 2,
        "plannedHomePosition": [LAT, LON, 584.0],
        "items": [
            simple(22, 15, 0, 0, None, LAT, LON, 10),
            SURVEY,
            simple(20, 0, 0, 0, 0, 0, 0, 0, frame=2),
        ],
    },
    "geoFence": {
        "version": 2,
        "polygons": [
            {
                "inclusion": True,
                "version": 1,
                "polygon": [
                    [LAT - 2e-3, LON - 2e-3],
                    [LAT + 2e-3, LON - 2e-3],
                    [LAT + 2e-3, LON + 2e-3],
                    [LAT - 2e-3, LON + 2e-3],
                ],
            }
        ],
        "circles": [
            {
                "inclusion": False,
                "version": 1,
                "circle": {"center": [LAT + 1e-3, LON], "radius": 20.0},
            }
        ],
    },
    "rallyPoints": {"version": 2, "points": [[LAT + 1e-4, LON, 15.0]]},
}
WAYPOINTS = (
    "QGC WPL 110\r\n"
    "0\t1\t0\t16\t0\t0\t0\t0\t-35.3632621\t149.1652374\t584.0\t1\r\n"
    "1\t0\t3\t22\t0.0\t0.0\t0.0\t0.0\t0.0\t0.0\t10.0\t1\r\n"
    "2\t0\t3\t16\t0.0\t0.0\t0.0\t0.0\t-35.3630\t149.1652\t15.0\t1\r\n"
)


def names() -> Names:
    commands = dialect("ardupilotmega").module.enums["MAV_CMD"]
    found = {entry.name.removeprefix("MAV_CMD_"): number for number, entry in commands.items()}
    return Names({number: name for name, number in found.items()}, found)


@pytest.fixture
async def pilot() -> AsyncIterator[Pilot]:
    async with flying() as found:
        await found.ready()
        yield found


async def test_a_plan_is_loaded_exported_and_loaded_again(pilot: Pilot) -> None:
    loaded = await pilot.do("action/plan/load", {"text": json.dumps(PLAN)})
    assert loaded["body"] == {"mission": 5, "fence": 5, "rally": 1}
    vehicle = pilot.vehicle
    assert len(vehicle.fence.plan.items) == 5
    assert [item.command for item in vehicle.flight.mission.plan.items[1:]] == [22, 16, 206, 16, 20]
    out = await pilot.do("service/plan/export")
    assert {name: out["body"][name] for name in ("mission", "fence", "rally")} == loaded["body"]
    plan = json.loads(out["body"]["text"])
    assert plan["geoFence"]["polygons"][0]["polygon"] == [
        [pytest.approx(lat, abs=1e-7), pytest.approx(lon, abs=1e-7)]
        for lat, lon in PLAN["geoFence"]["polygons"][0]["polygon"]
    ]
    (circle,) = plan["geoFence"]["circles"]
    assert (circle["inclusion"], circle["circle"]["radius"]) == (False, 20.0)
    assert plan["rallyPoints"]["points"] == [
        [pytest.approx(LAT + 1e-4, abs=1e-7), pytest.approx(LON, abs=1e-7), 15.0]
    ]
    assert plan["mission"]["plannedHomePosition"] == pytest.approx(vehicle.home, abs=1e-6)
    again = await pilot.do("action/plan/load", {"text": out["body"]["text"]})
    assert again["body"] == loaded["body"]
    assert (await pilot.do("service/plan/export"))["body"] == out["body"]


async def test_a_waypoint_file_replaces_the_mission_alone(pilot: Pilot) -> None:
    await pilot.do("action/plan/load", {"text": json.dumps(PLAN)})
    loaded = await pilot.do("action/plan/load", {"text": WAYPOINTS})
    assert loaded["body"] == {"mission": 2, "fence": None, "rally": None}
    assert len(pilot.vehicle.fence.plan.items) == 5
    out = (await pilot.do("service/plan/export", {"format": "waypoints"}))["body"]
    assert (out["mission"], out["text"].splitlines()[0]) == (2, "QGC WPL 110")
    assert parsed(out["text"], names()) == parsed(WAYPOINTS, names())
    assert (await pilot.do("action/plan/load", {"text": out["text"]}))["status"] == "completed"


async def test_a_loaded_plan_is_flown(pilot: Pilot) -> None:
    assert (await pilot.do("action/plan/load", {"text": json.dumps(PLAN)}))["status"] == "completed"
    await pilot.do("action/arm")
    flown = await pilot.do("action/mission/run")
    assert flown["status"] == "completed", flown
    assert pilot.vehicle.body.landed


BAD: list[tuple[dict[str, Any], dict[str, str]]] = [
    (
        {"mission": {"items": [simple(22, 0, 0, 0, 0, 95, 0, 10), simple(16, 0, 0, 0)]}},
        {
            "mission item 1": "latitude 95 is not within -90 to 90",
            "mission item 2": '"params" are not seven numbers',
        },
    ),
    (
        {"mission": {"items": [{"type": "ComplexItem", "complexItemType": "fwLandingPattern"}]}},
        {
            "mission item 1": "a complex item, fwLandingPattern, whose waypoints the file does not "
            "hold; save it as waypoints"
        },
    ),
    (
        {"geoFence": {"polygons": [{"polygon": [[0, 0], [1, 1]]}]}, "rallyPoints": {"points": [[1]]}},
        {
            "geoFence": "polygon 1 has fewer than three corners",
            "rallyPoints": "[1] is no position of two or three numbers",
        },
    ),
    (
        {"mission": {"items": [simple(16, 0, 0, 0, 0, 0, 0, 1, frame=1)]}, "geoFence": 3},
        {
            "mission item 1": "frame 1 is none of 0, 2, 3, 5, 6, 10, 11",
            "geoFence": "not an object",
        },
    ),
]  # fmt: skip


HUGE = 10**400
UNSENDABLE: list[dict[str, Any]] = [
    {"mission": {"items": [simple(16, 1e39, 0, 0, 0, LAT, LON, 9)]}},
    {"mission": {"items": [simple(16, HUGE, 0, 0, 0, LAT, LON, 9)]}},
    {"mission": {"items": [simple(16, 0, 0, 0, 0, HUGE, LON, 9)]}},
    {"mission": {"items": [simple(HUGE, 0, 0, 0, 0, LAT, LON, 9)]}},
    {"mission": {"items": [simple(65_536, 0, 0, 0, 0, LAT, LON, 9)]}},
    {"mission": {"items": [simple(-1, 0, 0, 0, 0, LAT, LON, 9)]}},
    {"mission": {"items": [simple(16, 0, 0, 0, 0, LAT, LON, 9, frame=HUGE)]}},
    {"mission": {"items": [simple(16, 0, 0, 0, 0, LAT, LON, 9)] * 10_001}},
    {"geoFence": {"circles": [{"circle": {"center": [LAT, LON], "radius": HUGE}}]}},
    {"geoFence": {"circles": [{"circle": {"center": [LAT, LON], "radius": 1e39}}]}},
    {"rallyPoints": {"points": [[HUGE, LON]]}},
]  # fmt: skip


@pytest.mark.parametrize("wrong", UNSENDABLE)
def test_what_no_message_can_carry_is_a_fault(wrong: dict[str, Any]) -> None:
    _, faults = parsed(json.dumps({**PLAN, **wrong}), names())
    assert len(faults) == 1
    assert len(faults[0].reason) < 200


def deep(n: int) -> str:
    inner = '{"type": "ComplexItem", "TransectStyleComplexItem": {"Items": [' * n + "]}}" * n
    return f'{{"fileType": "Plan", "mission": {{"items": [{inner}]}}}}'


@pytest.mark.parametrize(
    "text",
    [
        "[" * 500_000,
        deep(400),
        WAYPOINTS.replace("15.0", "1e39"),
        WAYPOINTS.replace("\t22\t", "\t70000\t"),
        WAYPOINTS.replace("15.0", "9" * 9000 + "x"),
        WAYPOINTS + "\n" * 10_000,
    ],
    ids=["brackets", "nested", "large", "command", "long", "lines"],
)
def test_a_file_that_nobody_could_send_is_a_fault(text: str) -> None:
    _, faults = parsed(text, names())
    assert len(faults) == 1
    assert len(faults[0].reason) < 200


async def test_nothing_is_sent_of_a_plan_that_cannot_be(pilot: Pilot) -> None:
    before = (await pilot.do("service/plan/export"))["body"]
    reply = await pilot.do("action/plan/load", {"text": json.dumps({**PLAN, **UNSENDABLE[0]})})
    assert (reply["status"], reply["error"]["code"]) == ("rejected", "invalid_value"), reply
    many = {"mission": {"items": [simple(16, 1e39, 0, 0, 0, LAT, LON, 9)] * 1000}}
    reply = await pilot.do("action/plan/load", {"text": json.dumps({**PLAN, **many})})
    assert len(reply["error"]["details"]["faults"]) == 100
    assert (await pilot.do("service/plan/export"))["body"] == before


async def test_an_error_of_the_gateway_puts_all_back(pilot: Pilot, monkeypatch: Any) -> None:
    await pilot.do("action/plan/load", {"text": json.dumps(PLAN)})
    before = (await pilot.do("service/plan/export"))["body"]
    plans = pilot.served.life.backend.robots[""].plans
    upload = plans.upload

    async def odd(kind: int, items: Any) -> int:
        if kind == MISSION and len(items) == 2:
            raise OverflowError("odd")
        return await upload(kind, items)

    monkeypatch.setattr(plans, "upload", odd)
    wrong = {"mission": {"items": [simple(16, 0, 0, 0, 0, LAT, LON, 9)] * 2}, "geoFence": {}}
    reply = await pilot.do("action/plan/load", {"text": json.dumps({**PLAN, **wrong})})
    assert reply["status"] == "failed", reply
    assert "those of before" in reply["message"]
    assert (await pilot.do("service/plan/export"))["body"] == before


async def test_a_bad_plan_is_refused_as_a_whole_with_each_item_and_reason(pilot: Pilot) -> None:
    await pilot.do("action/plan/load", {"text": json.dumps(PLAN)})
    before = (await pilot.do("service/plan/export"))["body"]
    for wrong, reasons in BAD:
        reply = await pilot.do("action/plan/load", {"text": json.dumps({**PLAN, **wrong})})
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "invalid_value"), reply
        faults = reply["error"]["details"]["faults"]
        assert {fault["where"]: fault["reason"] for fault in faults} == reasons
    row = WAYPOINTS.splitlines()[2]
    for text, where in (
        ("{", "the file"),
        ("[]", "the file"),
        ("QGC WPL 110\n" + row, "line 2"),  # not home
        (WAYPOINTS + "3\t0\t3\t16\t0\n", "line 5"),
        (WAYPOINTS + row.replace("10.0", "high").replace("1\t", "3\t", 1), "line 5"),
    ):
        reply = await pilot.do("action/plan/load", {"text": text})
        assert reply["error"]["code"] == "invalid_value", text
        assert [fault["where"] for fault in reply["error"]["details"]["faults"]] == [where]
    assert (await pilot.do("service/plan/export"))["body"] == before


async def test_a_part_that_the_vehicle_refuses_puts_all_back(pilot: Pilot) -> None:
    await pilot.do("action/plan/load", {"text": json.dumps(PLAN)})
    before = (await pilot.do("service/plan/export"))["body"]
    unknown = {"mission": {"items": [simple(16, 0, 0, 0, 0, LAT, LON, 9), simple(4501, 0, 0, 0, 0, LAT, LON, 9)]}}  # fmt: skip
    fence = {"geoFence": {"circles": [{"circle": {"center": [LAT, LON], "radius": 99}}]}}
    reply = await pilot.do("action/plan/load", {"text": json.dumps({**PLAN, **unknown, **fence})})
    assert (reply["status"], reply["error"]["code"]) == ("failed", "device_rejected"), reply
    assert "the plan is refused" in reply["message"]
    assert "those of before" in reply["message"]
    assert (await pilot.do("service/plan/export"))["body"] == before


class Planned(Puppet):
    """A PX4 that takes and gives a mission of one item."""

    def __init__(self) -> None:
        super().__init__(autopilot=PX4)
        self.item: Any = None
        gateway = (255, 190)
        self.on = {
            "MISSION_COUNT": lambda m: self.send("MISSION_REQUEST_INT", *gateway, 0, m.mission_type),
            "MISSION_ITEM_INT": self.keep,
            "MISSION_REQUEST_LIST": lambda m: self.send("MISSION_COUNT", *gateway, self.count(m), m.mission_type),
            "MISSION_REQUEST_INT": lambda _: self.send("MISSION_ITEM_INT", *gateway, *self.item),
        }  # fmt: skip

    def count(self, m: Any) -> int:
        return int(self.item is not None and self.item[-1] == m.mission_type)

    def keep(self, m: Any) -> None:
        self.item = (
            m.seq, m.frame, m.command, 0, 1, m.param1, m.param2, m.param3, m.param4, m.x, m.y, m.z, m.mission_type,
        )  # fmt: skip
        self.send("MISSION_ACK", 255, 190, 0, m.mission_type)


def jump(to: int) -> str:
    items = [simple(177, to, 2, 0, 0, 0, 0, 0, frame=2)]
    return json.dumps({"fileType": "Plan", "mission": {"items": items}})


async def test_a_jump_leads_to_the_same_item_without_home_in_the_mission() -> None:
    async with station(Planned()) as scene:
        reply = await scene.do("action/plan/load", {"text": jump(1)})
        assert reply["status"] == "completed", reply
        assert scene.puppet.item[2] == 177
        assert scene.puppet.item[5:7] == (0.0, 2.0)  # the first item of the vehicle
        for form in ("plan", "waypoints"):
            text = (await scene.do("service/plan/export", {"format": form}))["body"]["text"]
            mission = parsed(text, names())[0].mission
            assert mission is not None
            assert mission[0].params[:2] == (1.0, 2.0)
        refused = await scene.do("action/plan/load", {"text": jump(0)})
        assert refused["error"]["details"]["faults"][0]["where"] == "mission item 1"


async def test_a_jump_keeps_its_number_where_home_is_item_0(pilot: Pilot) -> None:
    assert (await pilot.do("action/plan/load", {"text": jump(1)}))["status"] == "completed"
    _, item = pilot.vehicle.flight.mission.plan.items
    assert (item.command, item.params[:2]) == (177, (1.0, 2.0))


async def test_what_is_not_set_stays_not_set_on_px4() -> None:
    """NaN keeps the heading; 0 would turn the vehicle north."""
    async with station(Planned()) as scene:
        plans = scene.robot.plans
        items = (Item("NAV_WAYPOINT", LAT, LON, 10.0, params=(0.0, 0.0, 0.0, None)),)
        await plans.upload(MISSION, items)
        assert math.isnan(scene.puppet.item[8])
        assert await plans.download(MISSION) == items


@pytest.mark.parametrize("kind", [MISSION, FENCE])
async def test_what_is_not_set_is_zero_on_ardupilot(pilot: Pilot, kind: int) -> None:
    command = {MISSION: "NAV_WAYPOINT", FENCE: "NAV_FENCE_CIRCLE_INCLUSION"}[kind]
    name = {MISSION: "action/mission/upload", FENCE: "service/fence/upload"}[kind]
    item = {"command": command, "latitude": LAT, "longitude": LON, "altitude": 10.0}
    reply = await pilot.do(name, {"items": [{**item, "params": [50.0, None]}]})
    assert reply["status"] == "completed", reply
    back = await pilot.do(name.replace("action", "service").replace("upload", "download"))
    assert back["body"]["items"][0]["params"] == [50.0, 0.0, 0.0, 0.0]
