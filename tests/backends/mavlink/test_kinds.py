"""Planes circle, rovers stop, boats stay: each kind of vehicle has what makes sense for it."""

from __future__ import annotations

import math
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from pymavlink import mavutil

from backends.mavlink.puppet import LAT, Puppet, Station, station
from rcp_gateway.testing import eventually
from rcp_mavlink.flightmodes import family
from timing import measured_load

PLANE, ROVER, BOAT, SUB, VTOL = 1, 10, 11, 12, 20


class Kind(Puppet):
    """It is where it is told to be a moment later, at `off` metres from it."""

    def __init__(self, type_: int, off: float = 0.0) -> None:
        super().__init__(type_=type_)
        self.off = off
        self.params = {"TKOFF_ALT": (50.0, 9), "WP_LOITER_RAD": (60.0, 9)}
        self.results = {
            176: self._mode, 400: self._arm, 22: lambda _: 3, 192: self._reposition
        }  # fmt: skip
        self.goal: tuple[float, float, float] | None = None
        self.driven: list[Any] = []
        self.on["SET_POSITION_TARGET_LOCAL_NED"] = self.driven.append
        self.also.append(self._go)

    @property
    def words(self) -> dict[int, str]:
        return family(3, self.type).modes

    def _mode(self, command: Any) -> int:
        self.mode = int(command.param2)
        word = self.words[self.mode]
        if word == "RTL":
            self.goal = (self.off, 0.0, self.height)
        elif word == "TAKEOFF":
            self.landed = 2
            self.goal = (0.0, 0.0, self.params["TKOFF_ALT"][0])
        return 0

    def _arm(self, command: Any) -> int:
        self.armed = bool(command.param1)
        return 0

    def _reposition(self, command: Any) -> int:
        self.mode = family(3, self.type).number("GUIDED") or 0
        north = (command.x / 1e7 - LAT) * 111_319.49
        height = 0.0 if self.type in (ROVER, BOAT) else command.z
        self.goal = (north + self.off, 0.0, height)
        return 0

    def _go(self) -> None:
        if self.goal is not None:
            self.move(*self.goal)
            self.goal = None


@asynccontextmanager
async def vehicle(type_: int, off: float = 0.0) -> AsyncGenerator[tuple[Station, Kind]]:
    puppet = Kind(type_, off)
    async with station(puppet) as found:
        robot = found.robot
        await eventually(lambda: _is(robot.vehicle.home is not None), "home is known")
        await eventually(lambda: _is(robot.parameters.complete.is_set()), "parameters are known")
        yield found, puppet


async def offered(found: Station) -> set[str]:
    reply = await found.client.request("discover", "/tenant/t/**")
    assert reply["status"] == "completed", reply
    return {entry["path"].removeprefix("/tenant/t/") for entry in reply["body"]["resources"]}


async def in_air(found: Station, puppet: Kind, mode: str = "GUIDED") -> None:
    puppet.armed, puppet.landed = True, 2
    puppet.mode = family(3, puppet.type).number(mode) or 0
    puppet.move(0.0, 0.0, 50.0)
    robot = found.robot
    await eventually(
        lambda: _is(robot.vehicle.landed is False and robot.vehicle.mode == mode), "it is seen"
    )


@pytest.mark.parametrize(
    ("type_", "kind", "without", "has"),
    [
        (2, "copter", set(), {"action/takeoff", "action/land", "actuator/velocity"}),
        (PLANE, "plane", {"action/land", "actuator/velocity"}, {"action/takeoff", "action/rtl"}),
        (VTOL, "vtol", {"actuator/velocity"}, {"action/takeoff", "action/land"}),
        (ROVER, "rover", {"action/takeoff", "action/land", "actuator/attitude"}, {"action/rtl"}),
        (BOAT, "boat", {"action/takeoff", "action/land"}, {"actuator/velocity"}),
        (SUB, "sub", {"action/takeoff", "action/rtl"}, {"actuator/velocity"}),
    ],
)
async def test_a_kind_has_what_makes_sense_for_it(
    type_: int, kind: str, without: set[str], has: set[str]
) -> None:
    async with vehicle(type_) as (found, _):
        assert (await found.read("sensor/vehicle"))["kind"] == kind
        (listed,) = (await found.client.request("read", "/system/robots"))["body"]
        assert (listed["kind"], listed["firmware"]) == (
            {"sub": "submarine"}.get(kind, kind),
            "ArduPilot",
        )
        names = await offered(found)
        assert not without & names
        assert has <= names


async def test_a_plane_takes_off_by_its_mode_to_the_height_it_is_given() -> None:
    async with vehicle(PLANE) as (found, puppet):
        assert (await found.do("action/arm"))["status"] == "completed"
        risen = await found.do("action/takeoff", {"altitude": 80})
        assert risen["status"] == "completed", risen
        assert puppet.params["TKOFF_ALT"][0] == 80
        assert puppet.words[puppet.mode] == "TAKEOFF"


async def test_a_plane_is_there_when_it_circles_round_the_place() -> None:
    async with vehicle(PLANE, off=70.0) as (found, puppet):
        await in_air(found, puppet)
        there = await found.do("action/move_to", {"north": 900.0, "altitude": 60})
        assert there["status"] == "completed", there
        assert there["body"]["error"] == pytest.approx(70.0, abs=1.0)
        puppet.move(900.0, 0.0, 60.0)
        home = await found.do("action/rtl")
        assert home["status"] == "completed", home
        assert puppet.armed


async def stopped(found: Station) -> dict[str, Any]:
    """Request a stop, which is to be answered in 10 s; return the answer."""
    with measured_load() as load:
        began = time.monotonic()
        reply = await found.client.request("execute", "/system/estop")
        took = time.monotonic() - began
    assert took < load.allows(10.0, 5.0), took
    return reply


async def test_a_plane_that_is_stopped_circles() -> None:
    async with vehicle(PLANE) as (found, puppet):
        await in_air(found, puppet)
        puppet.velocity = (20.0, 0.0, 0.0)
        stop = await stopped(found)
        assert stop["status"] == "completed", stop
        assert puppet.words[puppet.mode] == "LOITER"


@pytest.mark.parametrize("type_", [ROVER, BOAT])
async def test_what_drives_goes_there_and_comes_home(type_: int) -> None:
    async with vehicle(type_) as (found, puppet):
        refused = await found.do("action/move_to", {"north": 40.0})
        assert refused["error"]["code"] == "precondition_failed"
        assert (await found.do("action/arm"))["status"] == "completed"
        there = await found.do("action/move_to", {"north": 40.0})
        assert there["status"] == "completed", there
        home = await found.do("action/rtl")
        assert home["status"] == "completed", home
        assert puppet.armed
        stop = await stopped(found)
        assert stop["status"] == "completed", stop
        assert puppet.words[puppet.mode] == ("HOLD" if type_ == ROVER else "LOITER")


async def test_a_rover_is_driven_by_speed_and_turning_rate() -> None:
    async with vehicle(ROVER) as (found, puppet):
        puppet.armed = True
        puppet.mode = 15
        await eventually(lambda: _is(found.robot.vehicle.mode == "GUIDED"), "it is seen")
        sideways = await found.write("actuator/velocity", {"y": 1.0})
        assert sideways["error"]["code"] == "invalid_value"
        reply = await found.write("actuator/velocity", {"x": 1.5, "yaw_rate": 0.2})
        assert reply["status"] == "completed", reply
        await eventually(lambda: _is(bool(puppet.driven)), "it is told")
        first = puppet.driven[0]
        assert (first.vx, first.vy, first.coordinate_frame) == (1.5, 0.0, 8)
        assert math.isclose(first.yaw_rate, -0.2, rel_tol=1e-5)


@pytest.mark.parametrize(
    ("type_", "theirs"),
    [
        (2, mavutil.mode_mapping_acm), (PLANE, mavutil.mode_mapping_apm),
        (ROVER, mavutil.mode_mapping_rover), (SUB, mavutil.mode_mapping_sub),
    ],
)  # fmt: skip
def test_mode_numbers_are_those_of_pymavlink(type_: int, theirs: dict[int, str]) -> None:
    ours = family(3, type_).modes
    both = ours.keys() & theirs.keys()
    assert len(both) >= 10 or type_ == SUB
    differ = {n: (ours[n], theirs[n]) for n in both if ours[n] != theirs[n].replace("-", "_")}
    assert not {n: pair for n, pair in differ.items() if _bare(pair[0]) != _bare(pair[1])}


def _bare(word: str) -> str:
    return word.replace("_", "").replace("MANUAL", "MAN").lower()


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
