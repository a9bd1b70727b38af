"""A journey has the speed and the heading that were asked for, or says that it has not."""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest

import rcp_mavlink.pace
from backends.mavlink.flying import airborne, skip, speed
from backends.mavlink.puppet import LAT, LON, Puppet, Station, station
from backends.mavlink.test_gateway import Pilot, flying
from backends.mavlink.test_px4 import Px4
from backends.mavlink.test_px4 import airborne as airborne_px4
from rcp_gateway.testing import eventually
from rcp_mavlink_sim import Vehicle
from rcp_mavlink_sim.modes import Mode

REPOSITION, CHANGE_SPEED, CONDITION_YAW = 192, 178, 115
GUIDED, BRAKE = 4, 17
EAST = math.pi / 2


def recorded(vehicle: Vehicle) -> list[float]:
    """Have the speed over ground of each step of the simulation, m/s."""
    speeds: list[float] = []
    step = vehicle.body.step

    def stepped(dt: float) -> None:
        step(dt)
        speeds.append(math.hypot(vehicle.body.vn, vehicle.body.ve))

    vehicle.body.step = stepped
    return speeds


@asynccontextmanager
async def aloft(**options: Any) -> AsyncGenerator[Pilot]:
    async with flying(options) as pilot:
        airborne(pilot.vehicle)
        await pilot.ready()
        backend = pilot.served.life.backend
        await backend.robots[""].parameters.complete.wait()
        yield pilot


async def test_a_copter_flies_as_fast_as_it_is_asked_to_and_looks_where_it_should() -> None:
    async with aloft() as pilot:
        speeds = recorded(pilot.vehicle)
        reply = await pilot.do("action/move_to", {"north": 60.0, "speed": 2.0, "yaw": EAST})
        assert reply["status"] == "completed", reply
        assert max(speeds) == pytest.approx(2.0, abs=0.3)
        assert sorted(speeds)[len(speeds) // 2] == pytest.approx(2.0, abs=0.1)
        assert pilot.vehicle.body.yaw == pytest.approx(EAST, abs=0.1)
        assert reply["body"]["speed"] == pytest.approx(2.0, abs=0.3)
        assert reply["body"]["yaw"] == pytest.approx(EAST, abs=0.1)
        assert pilot.vehicle.body.n == pytest.approx(60, abs=1.5)

        del speeds[:]
        reply = await pilot.do("action/move_to", {"north": 250.0})
        assert reply["status"] == "completed", reply
        assert max(speeds) > 8, "the speed of the journey before has ended with it"


@pytest.mark.parametrize("asked", [-EAST, -0.2, 2 * math.pi, 0.0])
async def test_any_heading_is_one_that_the_vehicle_takes(asked: float) -> None:
    async with aloft(heading=120.0) as pilot:
        reply = await pilot.do("action/move_to", {"north": 15.0, "yaw": asked})
        assert reply["status"] == "completed", reply
        off = math.remainder(pilot.vehicle.body.yaw - asked, math.tau)
        assert abs(off) < 0.12


async def test_a_rover_drives_as_fast_as_it_is_asked_to_and_takes_no_heading() -> None:
    async with flying({"vehicle": "rover"}) as pilot:
        vehicle = pilot.vehicle
        assert vehicle.arm()
        await eventually(
            lambda: _is(pilot.served.life.backend.robots[""].vehicle.armed), "it is armed"
        )
        speeds = recorded(vehicle)
        refused = await pilot.do("action/move_to", {"north": 30.0, "yaw": 1.0})
        assert refused["error"]["code"] == "invalid_value"
        assert refused["error"]["details"]["pointer"] == "/yaw"
        assert max(speeds, default=0.0) < 0.1
        reply = await pilot.do("action/move_to", {"north": 30.0, "speed": 1.0})
        assert reply["status"] == "completed", reply
        assert max(speeds) == pytest.approx(1.0, abs=0.2)


async def test_a_plane_flies_at_an_airspeed_within_its_bounds() -> None:
    async with flying({"vehicle": "plane"}) as pilot:
        vehicle = pilot.vehicle
        vehicle.flight.set_mode(Mode.TAKEOFF)
        assert vehicle.arm()
        skip(vehicle, lambda: -vehicle.body.d > 45)
        robot = pilot.served.life.backend.robots[""]
        await eventually(lambda: _is(robot.vehicle.landed is False), "it flies")
        await robot.parameters.complete.wait()
        refused = await pilot.do("action/move_to", {"north": 900.0, "speed": 5.0})
        assert refused["error"]["code"] == "out_of_range"
        assert "12 to 30 m/s" in refused["message"]
        assert vehicle.flight.mode is Mode.TAKEOFF
        reply = await pilot.do("action/move_to", {"north": 900.0, "altitude": 60.0, "speed": 17.0})
        assert reply["status"] == "completed", reply["error"]
        assert vehicle.pilot.limits.speed == 17
        assert vehicle.body.airspeed == pytest.approx(17, abs=1)


async def test_a_place_outside_the_fence_is_refused_by_the_name_of_the_fence() -> None:
    given = {"FENCE_ENABLE": 1, "FENCE_RADIUS": 50, "FENCE_ALT_MAX": 60, "DISARM_DELAY": 0}
    async with aloft(parameters=given) as pilot:
        await eventually(lambda: _fenced(pilot), "the fence is seen to be on")
        for goal, why in (
            ({"north": 90.0}, "90 m from home is outside the fence, FENCE_RADIUS 50 m"),
            ({"altitude": 80.0}, "80 m above home is above the fence, FENCE_ALT_MAX 60 m"),
        ):
            dry = await pilot.do("action/move_to", goal, dry_run=True)
            assert dry["error"]["code"] == "device_rejected"
            assert dry["message"] == f"move_to: {why}"
            reply = await pilot.do("action/move_to", goal)
            assert reply["error"]["code"] == "device_rejected"
            assert reply["message"] == f"move_to: failed: {why}"
            assert "inside the fence" in reply["error"]["remedy"]
            assert pilot.vehicle.flight.mode is Mode.GUIDED
            assert speed(pilot.vehicle) < 0.3


async def test_a_dry_run_knows_whether_it_flies() -> None:
    async with flying({}) as pilot:
        await pilot.ready()
        for name, body, why in (
            ("action/takeoff", {"altitude": 10.0}, "not armed"),
            ("action/move_to", {"north": 10.0}, "not in the air"),
            ("action/land", None, "already on the ground"),
        ):
            dry = await pilot.do(name, body, dry_run=True)
            real = await pilot.do(name, body)
            assert dry["error"]["code"] == real["error"]["code"] == "precondition_failed"
            assert dry["message"] == real["message"]
            assert why in dry["message"]
        airborne(pilot.vehicle)
        await pilot.ready()
        for name, body in (("action/move_to", {"north": 10.0}), ("action/land", None)):
            dry = await pilot.do(name, body, dry_run=True)
            assert dry["status"] == "completed", dry
        climbing = await pilot.do("action/takeoff", {"altitude": 10.0}, dry_run=True)
        assert "in the air" in climbing["message"]


async def test_a_fence_that_is_crossed_on_the_way_is_in_the_error() -> None:
    async with aloft() as pilot:
        vehicle = pilot.vehicle
        path = "/tenant/t/action/move_to"
        id_ = await pilot.client.send(type="execute", path=path, body={"north": 900.0})
        await eventually(lambda: _is(speed(vehicle) > 3), "it moves")
        vehicle.params.set("FENCE_RADIUS", 30)
        vehicle.params.set("FENCE_ENABLE", 1)
        final = await pilot.client.final(id_, 10.0)
        assert final["error"]["code"] == "device_rejected"
        assert "Circle fence breached" in final["message"]
        assert vehicle.flight.mode is Mode.RTL


async def _fenced(pilot: Pilot) -> bool:
    return rcp_mavlink.fences.is_enabled(pilot.served.life.backend.robots[""].vehicle)


# What acknowledges and does otherwise


class Liar(Puppet):
    """It accepts what is not in `refuses`, and does what the test sets."""

    def __init__(self) -> None:
        super().__init__()
        self.mode, self.armed, self.landed = GUIDED, True, 2
        self.refuses: set[int] = set()
        self.results = dict.fromkeys((REPOSITION, CHANGE_SPEED, CONDITION_YAW), self._answer)
        self.results[176] = self._mode

    def _mode(self, command: Any) -> int:
        self.mode, self.velocity = int(command.param2), (0.0, 0.0, 0.0)
        return 0

    def _answer(self, command: Any) -> int:
        return 4 if command.command in self.refuses else 0

    @property
    def aimed(self) -> list[float]:
        """How far north each place was that it was sent to, m."""
        return [(m.x / 1e7 - LAT) * 111_319.49 for m in self.commands(REPOSITION)]


@asynccontextmanager
async def liar() -> AsyncGenerator[tuple[Station, Liar]]:
    puppet = Liar()
    puppet.move(0.0, 0.0, 20.0)
    async with station(puppet) as found:
        vehicle = found.robot.vehicle
        await eventually(
            lambda: _is(vehicle.landed is False and vehicle.home is not None), "it is seen"
        )
        yield found, puppet


@pytest.mark.parametrize(
    ("number", "goal"), [(CHANGE_SPEED, {"speed": 2.0}), (CONDITION_YAW, {"yaw": 1.0})]
)
async def test_what_it_refuses_is_told_before_it_goes_anywhere(number: int, goal: Any) -> None:
    async with liar() as (found, puppet):
        puppet.refuses.add(number)
        reply = await found.do("action/move_to", {"north": 90.0, **goal})
        assert reply["error"]["code"] == "device_rejected", reply
        assert next(iter(goal)) in reply["message"]
        assert all(abs(north) < 1 for north in puppet.aimed)
        assert puppet.mode == GUIDED


async def test_one_that_flies_faster_than_it_acknowledged_is_stopped_and_told() -> None:
    async with liar() as (found, puppet):
        puppet.velocity = (9.7, 0.0, 0.0)
        vehicle = found.robot.vehicle
        await eventually(lambda: _is(vehicle.fix.speed > 9), "it is seen to move")
        puppet.velocity = (0.0, 0.0, 0.0)
        await eventually(lambda: _is(vehicle.fix.speed < 1), "it is seen at rest")
        puppet.results[REPOSITION] = lambda _: setattr(puppet, "velocity", (9.7, 0.0, 0.0)) or 0
        reply = await found.do("action/move_to", {"north": 900.0, "speed": 2.0})
        assert reply["error"]["code"] == "device_rejected", reply
        assert "2 m/s requested, but it moves at 9.7 m/s" in reply["message"]
        assert puppet.mode == BRAKE


async def test_one_that_is_there_and_looks_elsewhere_is_told(monkeypatch: Any) -> None:
    monkeypatch.setattr(rcp_mavlink.pace, "_TURNING", 0.5)
    async with liar() as (found, puppet):
        reply = await found.do("action/move_to", {"north": 0.0, "east": 0.0, "yaw": 2.0})
        assert reply["error"]["code"] == "device_rejected", reply
        assert "it is at the target, but its heading is 0.00 rad, not 2.00 rad" in reply["message"]
        assert puppet.mode == BRAKE


async def test_px4_has_speed_and_heading_with_the_place() -> None:
    puppet = Px4()
    async with station(puppet) as found:
        await airborne_px4(found, puppet)
        reply = await found.do("action/move_to", {"north": 30.0, "speed": 3.0, "yaw": 0.0})
        assert reply["status"] == "completed", reply
        await found.do("action/move_to", {"north": 10.0})
        first, second = puppet.commands(REPOSITION)
        assert (first.param1, first.param4) == (3.0, 0.0)
        assert second.param1 == -1
        assert math.isnan(second.param4)
        assert puppet.commands(CHANGE_SPEED) == puppet.commands(CONDITION_YAW) == []
        assert first.y == round(LON * 1e7)


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
