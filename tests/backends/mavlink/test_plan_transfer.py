"""Plans over a link that loses messages, and beside another ground station."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from backends.mavlink.puppet import KIND, Puppet, station
from backends.mavlink.relay import Relay, relay
from backends.mavlink.test_gateway import LAT, LON, Pilot
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import serve_backend
from rcp_mavlink import plans
from rcp_mavlink_sim import Options, fly, vehicle_of

MISSION_REQUEST, MISSION_ACK, MISSION_REQUEST_INT = 40, 47, 51
ITEMS = [
    {"command": "NAV_WAYPOINT", "latitude": LAT + n * 1e-4, "longitude": LON, "altitude": 10.0}
    for n in range(4)
]


@asynccontextmanager
async def lossy(kind: str) -> AsyncGenerator[tuple[Pilot, Relay]]:
    vehicle = vehicle_of(Options(vehicle=kind, warmup=0.0))
    async with (
        fly(vehicle, "udpin:127.0.0.1:0") as running,
        relay(("127.0.0.1", running.ports[0][1])) as line,
    ):
        table = {"links": [f"udpout:127.0.0.1:{line.port}"], "timeout": 0.5}
        async with serve_backend(KIND, table) as served:
            await eventually(lambda: _is(served.lives and served.life.backend.robots), "it is open")
            yield Pilot(served, running), line


def losing(line: Relay, *numbers: int, place: int) -> None:
    """Lose one message of these numbers, by its place."""
    seen = 0

    def down(number: int) -> bool:
        nonlocal seen
        seen += number in numbers
        return number not in numbers or seen != place + 1

    line.down = down


@pytest.mark.parametrize("kind", ["copter", "px4"])
@pytest.mark.parametrize("place", [0, 2])
async def test_a_lost_request_is_no_refusal_of_the_plan(kind: str, place: int) -> None:
    async with lossy(kind) as (pilot, line):
        losing(line, MISSION_REQUEST, MISSION_REQUEST_INT, place=place)
        reply = await pilot.do("action/mission/upload", {"items": ITEMS})
        assert reply["status"] == "completed", reply
        assert len(pilot.vehicle.flight.mission.plan.items) == 5


@pytest.mark.parametrize("kind", ["copter", "px4"])
async def test_a_plan_whose_last_answer_was_lost_is_read_back(kind: str) -> None:
    async with lossy(kind) as (pilot, line):
        losing(line, MISSION_ACK, place=0)
        reply = await pilot.do("action/mission/upload", {"items": ITEMS})
        assert reply["status"] == "completed", reply
        assert len(pilot.vehicle.flight.mission.plan.items) == 5


@pytest.mark.parametrize("kind", ["copter", "px4"])
async def test_an_upload_that_breaks_off_may_leave_a_part_of_each(kind: str) -> None:
    async with lossy(kind) as (pilot, line):
        done = await pilot.do("action/mission/upload", {"items": ITEMS})
        assert done["status"] == "completed", done
        line.up = lambda m: m.get_type() != "MISSION_ITEM_INT" or m.seq < 2
        reply = await pilot.do("action/mission/upload", {"items": ITEMS[:0:-1]})
        assert reply["status"] == "failed", reply
        assert ("part of each" in reply["error"]["remedy"]) == (kind == "copter")
        kept = [round((i.lat - LAT) * 1e4) for i in pilot.vehicle.flight.mission.plan.items[1:]]
        assert kept == {"copter": [3, 1, 2], "px4": [0, 1, 2, 3]}[kind]


def circle(radius: float) -> list[dict[str, Any]]:
    return [
        {
            "command": "NAV_FENCE_CIRCLE_INCLUSION", "frame": "absolute", "params": [radius],
            "latitude": LAT, "longitude": LON,
        }
    ]  # fmt: skip


def lowered() -> list[dict[str, Any]]:
    """Return the plan, with its last item lower."""
    return [*ITEMS[:-1], {**ITEMS[-1], "altitude": 5.0}]


@pytest.mark.parametrize("answer", ["heard", "lost"])
async def test_a_smaller_fence_that_is_refused_is_not_completed(answer: str) -> None:
    async with lossy("copter") as (pilot, line):
        done = await pilot.do("service/fence/upload", {"items": circle(500.0)})
        assert done["status"] == "completed", done
        pilot.vehicle.faults.storage_full = True
        if answer == "lost":
            losing(line, MISSION_ACK, place=0)
        reply = await pilot.do("service/fence/upload", {"items": circle(50.0)})
        assert reply["status"] == ("failed" if answer == "lost" else "rejected"), reply
        assert pilot.vehicle.fence.plan.items[0].params[0] == 500.0


@pytest.mark.parametrize("kind", ["copter", "px4"])
@pytest.mark.parametrize("answer", ["heard", "lost"])
async def test_a_plan_that_differs_in_a_height_is_another_one(kind: str, answer: str) -> None:
    async with lossy(kind) as (pilot, line):
        await pilot.do("action/mission/upload", {"items": ITEMS})
        pilot.vehicle.faults.storage_full = True
        if answer == "lost":
            losing(line, MISSION_ACK, place=0)
        reply = await pilot.do("action/mission/upload", {"items": lowered()})
        assert reply["status"] == "failed", reply
        assert ("part of each" in (reply["error"]["remedy"] or "")) == (kind == "copter")
        assert pilot.vehicle.flight.mission.plan.items[-1].alt == 10.0


async def test_a_px4_that_never_received_the_last_item_keeps_its_plan() -> None:
    async with lossy("px4") as (pilot, line):
        await pilot.do("action/mission/upload", {"items": ITEMS})
        line.up = lambda m: m.get_type() != "MISSION_ITEM_INT" or m.seq < 3
        line.down = lambda number: number != MISSION_ACK
        reply = await pilot.do("action/mission/upload", {"items": lowered()})
        assert reply["status"] == "failed", reply
        assert reply["error"]["code"] == "device_timeout", reply


async def test_a_plan_without_positions_and_with_parameters_is_read_back() -> None:
    items = [
        ITEMS[0],
        {"command": "DO_CHANGE_SPEED", "params": [1, 3.3, None]},
        {**ITEMS[1], "frame": "absolute", "altitude": 600.1},
    ]
    for kind in ("copter", "px4"):
        async with lossy(kind) as (pilot, line):
            losing(line, MISSION_ACK, place=0)
            reply = await pilot.do("action/mission/upload", {"items": items})
            assert reply["status"] == "completed", reply


async def test_rally_points_that_are_refused_in_the_middle_may_be_mixed() -> None:
    rally = [{**each, "command": "NAV_RALLY_POINT"} for each in ITEMS]
    async with lossy("copter") as (pilot, line):
        done = await pilot.do("service/rally/upload", {"items": rally})
        assert done["status"] == "completed", done
        losing(line, MISSION_ACK, place=0)
        done = await pilot.do("service/rally/upload", {"items": rally[::-1]})
        assert done["status"] == "completed", done
        pilot.vehicle.faults.storage_full = True
        reply = await pilot.do("service/rally/upload", {"items": rally[:2]})
        assert reply["status"] == "failed", reply
        assert "part of each" in reply["error"]["remedy"]
        kept = [round((i.lat - LAT) * 1e4) for i in pilot.vehicle.rally.items]
        assert kept == [0, 2]


class Busy(Puppet):
    """It loses the last item, and denies a download until it has given up the upload."""

    def __init__(self, denials: int) -> None:
        super().__init__()
        self.denials = denials
        self.on["MISSION_COUNT"] = lambda _: self.send("MISSION_REQUEST_INT", 255, 190, 0, 1)
        self.on["MISSION_ITEM_INT"] = lambda _: None
        self.on["MISSION_REQUEST_LIST"] = self.deny
        self.on["MISSION_REQUEST_INT"] = self.tell_item

    def deny(self, _: Any) -> None:
        self.denials -= 1
        if self.denials >= 0:
            self.send("MISSION_ACK", 255, 190, 14, 1)
        else:
            self.send("MISSION_ACK", 255, 190, 1, 1)  # to the last item, sent again
            self.send("MISSION_COUNT", 255, 190, 1, 1)

    def tell_item(self, _: Any) -> None:
        place = round(LAT * 1e7), round(LON * 1e7)
        self.send("MISSION_ITEM_INT", 255, 190, 0, 0, 5003, 0, 1, 50.0, 0, 0, 0, *place, 0, 1)


@pytest.mark.parametrize("radius", [50.0, 40.0])
async def test_a_download_that_is_denied_meanwhile_is_asked_for_again(radius: float) -> None:
    puppet = Busy(denials=2)
    async with station(puppet, timeout=0.1) as found:
        reply = await found.do("service/fence/upload", {"items": circle(radius)})
        assert reply["status"] == ("completed" if radius == 50.0 else "failed"), reply
        assert len(puppet.messages("MISSION_REQUEST_LIST")) == 3


async def test_a_download_that_stays_denied_leaves_the_doubt(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(plans, "_RECEIVING", 0.5)
    async with station(Busy(denials=1000), timeout=0.1) as found:
        reply = await found.do("service/fence/upload", {"items": circle(50.0)})
        assert reply["status"] == "failed", reply
        assert reply["error"]["code"] == "device_timeout"


async def test_a_vehicle_that_calls_every_item_out_of_turn_ends_the_upload(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(plans, "_STUCK", 0.3)
    puppet = Busy(denials=0)
    puppet.on["MISSION_ITEM_INT"] = lambda _: puppet.send("MISSION_ACK", 255, 190, 13, 1)
    puppet.also.append(lambda: puppet.send("MISSION_ACK", 255, 190, 13, 1))
    async with station(puppet, timeout=0.1) as found:
        reply = await found.do("service/fence/upload", {"items": circle(50.0)}, within=60.0)
        assert reply["status"] == "rejected", reply
        assert "invalid sequence" in reply["message"]


class Keeper(Puppet):
    """It refuses the last item by an error, and keeps the plan that it has."""

    def __init__(self) -> None:
        super().__init__()
        self.on["MISSION_COUNT"] = lambda _: self.send("MISSION_REQUEST_INT", 255, 190, 0, 0)
        self.on["MISSION_ITEM_INT"] = self.take_item
        self.on["MISSION_REQUEST_LIST"] = lambda _: self.send("MISSION_COUNT", 255, 190, 0, 0)

    def take_item(self, item: Any) -> None:
        if item.seq < 1:
            self.send("MISSION_REQUEST_INT", 255, 190, item.seq + 1, 0)
        else:
            self.send("MISSION_ACK", 255, 190, 1, 0)


async def test_a_plan_that_is_refused_at_its_last_item_is_refused() -> None:
    async with station(Keeper()) as found:
        reply = await found.do("action/mission/upload", {"items": ITEMS[:1]})
        assert reply["status"] == "failed", reply
        assert reply["error"]["code"] == "device_rejected"
        assert "the plan is refused: failed" in reply["message"]


class Shared(Puppet):
    """Another ground station uploads and downloads at the same time."""

    def __init__(self) -> None:
        super().__init__()
        self.taken: list[int] = []
        self.on["MISSION_COUNT"] = self.begin
        self.on["MISSION_ITEM_INT"] = self.take_item

    def begin(self, _: Any) -> None:
        self.send("MISSION_REQUEST_INT", 254, 190, 1, 0)
        self.send("MISSION_ACK", 254, 190, 0, 0)
        self.send("MISSION_ACK", 255, 230, 0, 0)
        self.send("MISSION_REQUEST_INT", 255, 190, 0, 0)

    def take_item(self, item: Any) -> None:
        self.taken.append(item.seq)
        if item.seq < 4:
            self.send("MISSION_REQUEST_INT", 255, 190, item.seq + 1, 0)
        else:
            self.send("MISSION_ACK", 255, 190, 0, 0)


async def test_what_a_vehicle_tells_another_ground_station_confirms_nothing() -> None:
    puppet = Shared()
    async with station(puppet) as found:
        reply = await found.do("action/mission/upload", {"items": ITEMS})
        assert reply["status"] == "completed", reply
        assert puppet.taken == [0, 1, 2, 3, 4]


class Late(Puppet):
    """It accepts an upload of before when the next one has begun."""

    def __init__(self) -> None:
        super().__init__()
        self.taken: list[int] = []
        self.on["MISSION_COUNT"] = self.begin
        self.on["MISSION_ITEM_INT"] = self.take_item

    def begin(self, _: Any) -> None:
        self.send("MISSION_ACK", 255, 190, 0, 0)
        self.send("MISSION_REQUEST_INT", 255, 190, 0, 0)

    def take_item(self, item: Any) -> None:
        self.taken.append(item.seq)
        if item.seq < 2:
            self.send("MISSION_REQUEST_INT", 255, 190, item.seq + 1, 0)
        else:
            self.send("MISSION_ACK", 255, 190, 14, 0)


async def test_a_late_yes_to_a_plan_of_before_is_none_to_the_next() -> None:
    puppet = Late()
    async with station(puppet) as found:
        reply = await found.do("action/mission/upload", {"items": ITEMS})
        assert reply["error"]["code"] == "device_rejected", reply
        assert set(puppet.taken) == {0, 1, 2}


async def _is(truth: object) -> bool:
    return bool(truth)
