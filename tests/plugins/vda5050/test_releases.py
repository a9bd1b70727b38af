"""Grants that end: told when the robot stands, and what then becomes of the request."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from rcp_geometry import Polygon
from rcp_vda5050.faults import Fault
from rcp_vda5050.zone_messages import Response, Vertex, Zone
from rcp_vda5050.zone_sets import Area, LoadedSet
from rcp_vda5050.zones import Zones

pytestmark = pytest.mark.anyio


class Driver:
    """Somebody who drives, and counts how often that is to be considered anew."""

    def __init__(self) -> None:
        self.driving = False
        self.stops = 0

    def reconsider(self) -> None:
        self.stops += 1

    def pause(self, fault: Fault | None = None) -> None:
        self.stops += 1

    def zone_entered(self, zone: Zone) -> None:
        pass

    def zone_left(self, zone: Zone) -> None:
        pass


def area(id_: str, left: float, right: float, loss: str | None = None) -> Area:
    corners = [(left, -1.0), (right, -1.0), (right, 1.0), (left, 1.0)]
    vertices = tuple(Vertex(*each) for each in corners)
    return Area(Zone(id_, "RELEASE", vertices, release_loss_behavior=loss), Polygon(corners))


def zones(*areas: Area) -> tuple[Zones, Driver]:
    driver = Driver()
    made = Zones(0.2, driver, lambda: None)
    made.sets.add(LoadedSet("s1", "hall", areas))
    assert made.enable("s1") is None
    made.moved((0.0, 0.0))
    return made, driver


def statuses(it: Zones) -> dict[str, str]:
    return {each["zoneId"]: each["requestStatus"] for each in it.releases.listed()}


def answer(it: Zones, zone: str, grant: Any, expiry: str | None = None) -> str | None:
    request = it.releases.of(zone)
    assert request is not None
    return it.releases.answer(Response(request.id, grant, expiry))


async def admitted(it: Zones, goal: float, *granted: str) -> Fault | None:
    """Ask for a drive, and grant zones as they are asked for."""
    task = asyncio.create_task(it.admit((goal, 0.0)))
    await asyncio.sleep(0)
    for zone in granted:
        assert not task.done()
        answer(it, zone, "GRANTED")
    async with asyncio.timeout(60):
        return await task


async def test_a_lost_grant_is_told_only_when_the_robot_stands() -> None:
    it, driver = zones(area("a", 1, 3), area("b", 2, 4, "CONTINUE"), area("c", 5, 6))
    assert await admitted(it, 8.0, "a", "b", "c") is None
    driver.driving = True
    it.moved((2.5, 0.0))
    for zone in ("a", "c"):
        answer(it, zone, "REVOKED")
    answer(it, "b", "REVOKED")  # which lets it go on, and is told at once
    assert statuses(it) == {"a": "GRANTED", "b": "REVOKED", "c": "GRANTED"}
    assert driver.stops == 2
    assert not it.admits((8.0, 0.0))
    driver.driving = False
    it.stands()
    assert statuses(it) == {"a": "REVOKED", "b": "REVOKED"}  # c was not entered
    assert [each.kind for each in it.faults()] == ["release"]
    assert answer(it, "a", "GRANTED") is None
    assert await admitted(it, 8.0, "c") is None
    assert it.faults() == []
    driver.driving = True
    it.moved((4.5, 0.0))
    assert statuses(it) == {"c": "GRANTED"}  # the others were left
    it.moved((5.5, 0.0))
    it.moved((7.0, 0.0))
    assert statuses(it) == {}


async def test_a_zone_that_is_not_granted_is_not_entered_on_another_way() -> None:
    it, driver = zones(area("a", 1, 3))
    assert await it.admit((0.0, 5.0)) is None  # the straight way is beside it
    driver.driving = True
    it.moved((0.7, 0.0))
    assert driver.stops == 0
    it.moved((0.85, 0.0))
    assert driver.stops == 1
    assert [each.kind for each in it.faults()] == ["release"]
    driver.driving = False
    it.stands()
    assert await admitted(it, 5.0, "a") is None
    assert it.faults() == []


async def test_who_is_moved_out_of_a_zone_still_waits_for_the_next() -> None:
    it, driver = zones(area("a", 1, 3), area("b", 5, 6))
    assert await admitted(it, 2.0, "a") is None
    it.moved((2.0, 0.0))
    it.arrived()
    waiting = asyncio.create_task(it.admit((8.0, 0.0)))
    await asyncio.sleep(0)
    assert statuses(it) == {"a": "GRANTED", "b": "REQUESTED"}
    it.moved((4.0, 0.0))  # by hand
    assert statuses(it) == {"b": "REQUESTED"}
    it.moved((0.0, 0.0))  # and back: the first one is on the way again
    await asyncio.sleep(0)
    answer(it, "b", "GRANTED")
    await asyncio.sleep(0)
    assert not waiting.done()
    assert statuses(it) == {"a": "REQUESTED", "b": "GRANTED"}
    answer(it, "a", "GRANTED")
    assert await waiting is None
    it.moved(None)
    fault = await it.admit((8.0, 0.0))
    assert fault is not None
    assert (fault.kind, fault.written("3.0")["errorLevel"]) == ("lost", "FATAL")
    assert driver.stops == 0


@pytest.mark.parametrize("expiry", ["soon", "2020-01-01T00:00:00Z", "2020-01-01T00:00:00", ""])
async def test_a_lease_that_is_over_or_no_time_grants_nothing(expiry: str) -> None:
    it, _ = zones(area("a", 1, 3))
    waiting = asyncio.create_task(it.admit((5.0, 0.0)))
    await asyncio.sleep(0)
    assert "leaseExpiry" in (answer(it, "a", "GRANTED", expiry) or "")
    assert not it.admits((5.0, 0.0))
    assert answer(it, "a", "GRANTED", "2999-01-01T00:00:00.000Z") is None
    assert await waiting is None
    it.releases.close()
