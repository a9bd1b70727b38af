"""Turns, circles, speeds and the current item: an ArduPilot by its modes, a PX4 by its commands."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from typing import Any

import pytest

from backends.mavlink.flying import airborne, speed
from backends.mavlink.test_equipment import error, estop
from backends.mavlink.test_gateway import LAT, LON, Pilot, flying
from backends.mavlink.test_px4 import HOLD, MISSION, Px4, px4
from backends.mavlink.test_px4 import airborne as px4_airborne
from rcp_gateway.testing import eventually
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.plans import Item

ORBIT = 3 << 16 | 1 << 24


@pytest.fixture
async def pilot() -> AsyncIterator[Pilot]:
    async with flying() as found:
        airborne(found.vehicle)
        await found.ready()
        await found.served.life.backend.robots[""].parameters.complete.wait()
        yield found


async def test_it_turns_to_a_heading_and_by_an_angle(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    done = await pilot.do("action/turn", {"heading": math.pi / 2})
    assert done["status"] == "completed", done
    assert done["body"]["heading"] == pytest.approx(math.pi / 2, abs=0.11)
    left = await pilot.do("action/turn", {"by": 0.5, "rate": 1.0})
    assert left["status"] == "completed", left
    assert vehicle.pilot.yaw == pytest.approx(math.pi / 2 - 0.5, abs=0.12)
    assert error(await pilot.do("action/turn", {})) == "invalid_value"
    vehicle.flight.set_mode(Mode.LOITER)
    await pilot.ready()
    assert error(await pilot.do("action/turn", {"by": 1.0})) == "mode_forbids"


async def test_the_speed_of_a_flight_is_changed_within_the_limit(pilot: Pilot) -> None:
    done = await pilot.do("service/change_speed", {"speed": 4.0})
    assert done["status"] == "completed", done
    assert pilot.vehicle.pilot.limits.speed == 4.0
    assert (await pilot.do("service/change_speed", {"speed": 1.0, "of": "climb"}))["body"]
    assert pilot.vehicle.pilot.limits.up == 1.0
    assert error(await pilot.do("service/change_speed", {"speed": 20.0})) == "out_of_range"
    fast = {"speed": 20.0, "of": "descent"}
    assert error(await pilot.do("service/change_speed", fast)) == "out_of_range"
    pilot.vehicle.flight.set_mode(Mode.LOITER)
    assert error(await pilot.do("service/change_speed", {"speed": 4.0})) == "device_rejected"


async def test_an_ardupilot_goes_round_a_point_that_is_given(pilot: Pilot) -> None:
    vehicle, far = pilot.vehicle, list[float]()
    step = vehicle.flight.step

    def seen(dt: float) -> None:
        step(dt)
        if vehicle.flight.mode is Mode.CIRCLE:
            far.append(math.dist((vehicle.body.n, vehicle.body.e), (0.0, 20.0)))

    vehicle.flight.step = seen  # type: ignore[method-assign]
    goal = {"radius": 6.0, "speed": 2.0, "clockwise": False, "position": {"x": 20.0, "y": 0.0}}
    done = await pilot.do("action/orbit", goal)
    assert done["status"] == "completed", done
    assert done["body"]["turns"] >= 1.0
    assert vehicle.params["CIRCLE_RADIUS"] == pytest.approx(600.0)
    assert vehicle.params["CIRCLE_RATE"] < 0
    assert max(far) < 8.0
    assert min(far) > 4.0
    await eventually(lambda: _is(speed(vehicle) < 0.3), "it holds")
    path = "/tenant/t/actuator/cmd_vel"
    next_ = await pilot.client.request("write", path, body={"linear": {"x": 1.0}}, valid_for=1.0)
    assert next_["status"] == "completed", "as after move_to"


async def test_an_orbit_is_stopped_by_a_cancel_and_an_estop(pilot: Pilot) -> None:
    vehicle, path = pilot.vehicle, "/tenant/t/action/orbit"
    for ends in (lambda: pilot.client.request("cancel", path), lambda: estop(pilot)):
        goal = {"radius": 10.0, "speed": 3.0, "turns": 100}
        id_ = await pilot.client.send(type="execute", path=path, body=goal)
        await eventually(
            lambda: _is(vehicle.flight.mode is Mode.CIRCLE and speed(vehicle) > 1.0),
            "it goes round",
        )
        await ends()
        assert (await pilot.client.final(id_, 30.0))["status"] != "completed"
        await eventually(lambda: _is(speed(vehicle) < 0.3), "it holds")
        assert vehicle.flight.mode is Mode.BRAKE


async def test_a_circle_that_crosses_the_fence_is_refused(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    vehicle.params.set("FENCE_ENABLE", 1)
    robot = pilot.served.life.backend.robots[""].vehicle

    def fenced() -> bool:
        enabled = robot.latest["SYS_STATUS"].fields()["onboard_control_sensors_enabled"]
        return bool(enabled >> 20 & 1)

    await eventually(lambda: _is(fenced()), "the fence is seen")
    centre = {"latitude": LAT + 290 / 111_319.49, "longitude": LON}
    reply = await pilot.do("action/orbit", {"radius": 20.0, **centre})
    assert error(reply) == "device_rejected"
    assert "FENCE_RADIUS" in reply["message"]
    assert vehicle.flight.mode is Mode.GUIDED


async def test_the_current_item_is_set_and_seen(pilot: Pilot) -> None:
    here = Item(16, 3, (0.0, 0.0, 0.0, 0.0), LAT, LON, 20.0, (round(LAT * 1e7), round(LON * 1e7)))
    mission = pilot.vehicle.flight.mission
    mission.plan.replace([here] * 4)
    mission.changed()
    done = await pilot.do("service/mission/set_current", {"item": 3})
    assert done["status"] == "completed", done
    assert (mission.current, done["body"]["item"]) == (3, 3)
    assert error(await pilot.do("service/mission/set_current", {"item": 9})) == "device_rejected"


async def test_a_px4_goes_round_by_its_own_command_and_turns_where_it_is() -> None:
    async with px4() as (found, puppet):
        await px4_airborne(found, puppet)
        flight = asyncio.create_task(
            found.do("action/orbit", {"radius": 10.0, "speed": 3.0, "altitude": 25.0, "turns": 1})
        )
        _circle(puppet)
        reply = await flight
        assert reply["status"] == "completed", reply
        (order,) = puppet.commands(34)
        assert (order.get_type(), order.frame) == ("COMMAND_INT", 5)
        assert (order.param1, order.param2, order.z) == pytest.approx((10.0, 3.0, 425.0))
        assert puppet.mode == HOLD
        turn = asyncio.create_task(found.do("action/turn", {"heading": 1.0}))
        await eventually(lambda: _is(_heads(puppet)), "it is told")
        puppet.heading = 1.0
        assert (await turn)["status"] == "completed"


async def test_a_px4_does_not_take_a_rate_of_climb_for_its_speed() -> None:
    async with px4() as (found, puppet):
        puppet.results[178] = lambda _: 0
        for of in ("climb", "descent"):
            reply = await found.do("service/change_speed", {"speed": 3.0, "of": of})
            assert error(reply) == "precondition_failed"
        assert not puppet.commands(178)
        assert (await found.do("service/change_speed", {"speed": 3.0}))["status"] == "completed"


async def test_a_circle_whose_answer_is_lost_is_held() -> None:
    async with px4() as (found, puppet):
        await px4_airborne(found, puppet)
        take = puppet.take

        def take_in_silence(message: Any) -> None:
            if message.get_type() == "COMMAND_INT" and message.command == 34:
                puppet.mode = ORBIT
            else:
                take(message)

        puppet.take = take_in_silence  # type: ignore[method-assign]
        reply = await found.do("action/orbit", {"radius": 10.0})
        assert error(reply) == "device_timeout"
        assert puppet.mode == HOLD


async def test_a_turn_goes_on_without_a_heading_for_a_moment() -> None:
    async with px4() as (found, puppet):
        await px4_airborne(found, puppet)
        turn = asyncio.create_task(found.do("action/turn", {"heading": 1.0}))
        await eventually(lambda: _is(_heads(puppet)), "it is told")
        puppet.heading = math.radians(655.35)
        vehicle = found.robot.vehicle

        def unknown() -> bool:
            return vehicle.latest["GLOBAL_POSITION_INT"].fields()["hdg"] == 65535

        await eventually(lambda: _is(unknown()), "it has no heading")
        puppet.mode = MISSION
        assert error(await turn) == "mode_forbids"


def _heads(puppet: Px4) -> bool:
    pauses = [order for order in puppet.commands(192) if order.param4 == 1.0]
    return bool(pauses) and all(math.isnan(order.param5) for order in pauses)


def _circle(puppet: Px4) -> None:
    """Go round the centre 10 m to the north, once told to."""
    angle = math.pi

    def orbit(_: Any) -> int:
        puppet.mode = ORBIT
        return 0

    def fly() -> None:
        nonlocal angle
        if puppet.mode == ORBIT:
            angle += 0.2
            puppet.move(10.0 + 10.0 * math.cos(angle), 10.0 * math.sin(angle), 25.0)

    puppet.results[34] = orbit
    puppet.also.append(fly)


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
