"""A copter with PX4 flown through the gateway alone, as those with ArduPilot are."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from backends.mavlink.flying import skip, speed
from backends.mavlink.test_equipment import estop
from backends.mavlink.test_gateway import KIND, LAT, LON, Pilot
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import serve_backend
from rcp_mavlink_sim import Options, Vehicle, fly, vehicle_of
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.px4.flight import HOLD

DEGREE = 111_319.49


class Px4Pilot(Pilot):
    async def ready(self) -> None:
        vehicle = self.vehicle

        async def same() -> bool:
            seen = self.served.life.backend.robots[""].vehicle
            return (
                (seen.armed, seen.mode_number, seen.landed)
                == (vehicle.armed, vehicle.kind.number(vehicle.flight.mode), vehicle.body.landed)
                and seen.home is not None
                and seen.fix is not None
                and abs(seen.fix.height + vehicle.body.d) < 0.5
            )

        await eventually(same, "the gateway sees what the vehicle does")


def aloft(vehicle: Vehicle, height: float = 20.0) -> None:
    """Put it into the air in HOLD, at rest."""
    assert vehicle.arm()
    assert vehicle.flight.take_off(height)
    skip(vehicle, lambda: vehicle.flight.mode is HOLD and speed(vehicle) < 0.1)


@asynccontextmanager
async def px4(
    *,
    up: bool = True,
    parameters: dict[str, float] | None = None,
    table: dict[str, Any] | None = None,
    **more: Any,
) -> AsyncGenerator[Px4Pilot]:
    given = {"COM_DISARM_PRFLT": 0.0, "MPC_XY_CRUISE": 10.0} | (parameters or {})
    options = {"warmup": 0.0, "speed": 10.0, "parameters": given} | more
    vehicle = vehicle_of(Options(vehicle="px4", **options))
    vehicle.advance(0.0, 1.0)
    if up:
        aloft(vehicle)
    async with fly(vehicle, "udpin:127.0.0.1:0") as twin:
        config = {
            "links": [f"udpout:127.0.0.1:{twin.ports[0][1]}"],
            "silence": 1.5,
            "feedback_timeout": 5.0,
        } | (table or {})
        async with serve_backend(KIND, config) as served:
            await eventually(lambda: _is(served.lives and served.life.backend.robots), "it is open")
            pilot = Px4Pilot(served, twin)
            await pilot.ready()
            yield pilot


@pytest.fixture
async def pilot() -> AsyncIterator[Px4Pilot]:
    async with px4() as found:
        yield found


async def test_out_and_back() -> None:
    async with px4(up=False) as pilot:
        vehicle = pilot.vehicle
        assert (await pilot.read("sensor/mode")) == "HOLD"
        info = await pilot.read("sensor/vehicle")
        assert (info["autopilot"], info["kind"]) == ("px4", "copter")
        assert (await pilot.do("action/arm"))["body"] == {"armed": True, "mode": "HOLD"}
        risen = await pilot.do("action/takeoff", {"altitude": 12})
        assert risen["status"] == "completed", risen
        assert -vehicle.body.d == pytest.approx(12, abs=0.7)
        goal = {"north": 40.0, "altitude": 15.0, "speed": 4.0, "yaw": 1.0}
        moved = await pilot.do("action/move_to", goal)
        assert moved["status"] == "completed", moved
        assert vehicle.body.n == pytest.approx(40, abs=1.5)
        assert moved["body"]["speed"] < 5.0
        assert vehicle.body.yaw == pytest.approx(1.0, abs=0.15)
        assert (await pilot.do("action/rtl"))["status"] == "completed"
        assert not vehicle.armed
        assert math.hypot(vehicle.body.n, vehicle.body.e) < 2


async def test_a_velocity_is_flown_in_offboard_and_ends_in_hold(pilot: Px4Pilot) -> None:
    vehicle = pilot.vehicle
    path = "/tenant/t/actuator/velocity"
    done = await pilot.client.request("write", path, body={"x": 3.0}, valid_for=1.0)
    assert done["status"] == "completed", done
    assert vehicle.flight.mode is Mode.OFFBOARD
    await eventually(lambda: _is(speed(vehicle) > 2.0), "it moves")
    await eventually(lambda: _is(vehicle.flight.mode is HOLD), "it holds when none comes")
    await eventually(lambda: _is(speed(vehicle) < 0.3), "it is at rest")


async def test_a_position_is_held_and_an_estop_stops_it(pilot: Px4Pilot) -> None:
    vehicle = pilot.vehicle
    where = {"position": {"x": 0.0, "y": 400.0, "z": 25.0}}
    path = "/tenant/t/actuator/position"
    done = await pilot.client.request("write", path, body=where, valid_for=30.0)
    assert done["status"] == "completed", done
    await eventually(lambda: _is(vehicle.body.n > 5), "it goes there")
    await estop(pilot)
    await eventually(lambda: _is(vehicle.flight.mode is HOLD and speed(vehicle) < 0.3), "it holds")
    assert vehicle.body.n < 390


async def test_a_mission_counts_from_its_first_item_and_ends_in_hold(pilot: Px4Pilot) -> None:
    items = [
        {"command": "NAV_WAYPOINT", "latitude": LAT + 2e-4, "longitude": LON, "altitude": 22.0, "params": [0, 0, 0, None]},
        {"command": "NAV_WAYPOINT", "latitude": LAT + 4e-4, "longitude": LON, "altitude": 24.0},
    ]  # fmt: skip
    assert (await pilot.do("action/mission/upload", {"items": items}))["body"] == {"count": 2}
    assert len(pilot.vehicle.flight.mission.plan.items) == 3
    back = (await pilot.do("service/mission/download"))["body"]["items"]
    assert [one["altitude"] for one in back] == [22.0, 24.0]
    assert back[0]["params"][3] is None, "NaN keeps the heading"
    run = await pilot.do("action/mission/run")
    assert run["status"] == "completed", run
    assert (run["body"]["item"], run["body"]["total"]) == (2, 2)
    assert pilot.vehicle.flight.mode is HOLD
    current = await pilot.do("service/mission/set_current", {"item": 2})
    assert current["status"] == "completed", current
    assert pilot.vehicle.flight.mission.current == 2


async def test_integers_are_read_and_written_by_their_bits(pilot: Px4Pilot) -> None:
    robot = pilot.served.life.backend.robots[""]
    await robot.parameters.complete.wait()
    assert len(robot.parameters.known) == len(pilot.vehicle.params.listed())
    assert await pilot.read("param/CAL_ACC0_ID") == 1310988
    assert await pilot.read("param/MAV_TYPE") == 2
    path = "/tenant/t/param"
    done = await pilot.client.request("write", f"{path}/COM_FLTMODE1", body=-1310989)
    assert done["status"] == "completed", done
    assert pilot.vehicle.params["COM_FLTMODE1"] == -1310989
    done = await pilot.client.request("write", f"{path}/MPC_XY_CRUISE", body=7.5)
    assert done["status"] == "completed", done
    assert pilot.vehicle.params["WPNAV_SPEED"] == 750
    assert (await pilot.do("service/param/save"))["status"] == "completed"


async def test_a_circle_a_turn_and_a_gimbal(pilot: Px4Pilot) -> None:
    vehicle = pilot.vehicle
    round_ = await pilot.do("action/orbit", {"radius": 8.0, "speed": 4.0, "turns": 1.0})
    assert round_["status"] == "completed", round_
    turned = await pilot.do("action/turn", {"heading": 2.0})
    assert turned["status"] == "completed", turned
    assert vehicle.body.yaw == pytest.approx(2.0, abs=0.15)
    looked = await pilot.do("action/gimbal", {"pitch": -0.5})
    assert looked["status"] == "completed", looked


async def test_it_is_not_armed_without_a_position() -> None:
    vehicle = vehicle_of(Options(vehicle="px4", warmup=1e4))
    async with fly(vehicle, "udpin:127.0.0.1:0") as twin:
        table = {"links": [f"udpout:127.0.0.1:{twin.ports[0][1]}"]}
        async with serve_backend(KIND, table) as served:
            await eventually(lambda: _is(served.lives and served.life.backend.robots), "it is open")
            reply = await Pilot(served, twin).do("action/arm")
            assert reply["error"]["code"] == "device_rejected"
            assert "Preflight Fail: Attitude failure (roll)" in reply["message"]


async def test_without_the_gateway_it_does_as_its_parameter_says() -> None:
    parameters = {"NAV_DLL_ACT": 2.0, "COM_DL_LOSS_T": 2.0, "RTL_RETURN_ALT": 22.0}
    async with px4(parameters=parameters) as pilot:
        backend: Any = pilot.served.life.backend
        await backend.robots[""].watchdogs.verified.wait()
        link, offboard, *_ = backend.watchdogs()
        assert (link.within, offboard.within) == (3.0, 1.0)
        pilot.twin.muted = True
        await eventually(lambda: _is(pilot.vehicle.flight.mode is Mode.RTL), "it returns")


async def test_a_pilot_who_takes_over_ends_what_flies_it(pilot: Px4Pilot) -> None:
    flight = asyncio.ensure_future(pilot.do("action/move_to", {"north": 400.0}))
    await eventually(lambda: _is(pilot.vehicle.body.n > 5), "it is on its way")
    assert pilot.vehicle.flight.set_mode(Mode.LOITER)  # POSCTL
    reply = await flight
    assert reply["error"]["code"] == "device_rejected"
    assert "POSCTL" in reply["message"]
    assert pilot.vehicle.flight.mode is Mode.LOITER


async def _is(truth: object) -> bool:
    return bool(truth)
