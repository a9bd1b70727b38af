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


async def _is(truth: object) -> bool:
    return bool(truth)
