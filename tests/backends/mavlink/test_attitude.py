"""An attitude without a yaw keeps the heading that the vehicle has."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from backends.mavlink.flying import airborne, speed
from backends.mavlink.puppet import station
from backends.mavlink.test_gateway import Pilot, flying
from backends.mavlink.test_px4 import OFFBOARD, Px4
from backends.mavlink.test_px4 import airborne as airborne_px4
from rcp_gateway.testing import eventually
from rcp_mavlink_sim.modes import Mode

PATH = "/tenant/t/actuator/attitude"
HEADING = 2.0


async def lean(pilot: Pilot, times: int = 12, **value: float) -> None:
    for _ in range(times):
        reply = await pilot.client.request("write", PATH, body=value, valid_for=0.4)
        assert reply["status"] == "completed", reply["error"]


async def test_it_looks_where_it_looked_and_turns_only_when_it_is_told() -> None:
    async with flying({"heading": math.degrees(HEADING)}) as pilot:
        airborne(pilot.vehicle)
        await pilot.ready()
        body = pilot.vehicle.body
        await lean(pilot, pitch=-0.2)
        await eventually(lambda: _is(speed(pilot.vehicle) > 2), "it moves")
        assert abs(math.remainder(body.yaw - HEADING, math.tau)) < 0.1
        course = math.atan2(body.ve, body.vn)
        assert abs(math.remainder(course - HEADING, math.tau)) < 0.2
        for yaw in (0.0, -2.5):
            await lean(pilot, 1, pitch=-0.1, yaw=yaw)

            async def turned(yaw: float = yaw) -> bool:
                await lean(pilot, 1, pitch=-0.1, yaw=yaw)
                return abs(math.remainder(body.yaw - yaw, math.tau)) < 0.1

            await eventually(turned, "it turns")
        await lean(pilot, pitch=-0.1)
        assert abs(math.remainder(body.yaw + 2.5, math.tau)) < 0.2
        await eventually(
            lambda: _is(pilot.vehicle.flight.mode is Mode.BRAKE), "it holds at last", 5.0
        )


async def test_the_heading_does_not_wander_while_it_is_kept() -> None:
    async with flying({"heading": math.degrees(HEADING), "noise": 5.0}) as pilot:
        airborne(pilot.vehicle)
        await pilot.ready()
        held: set[float] = set()
        for _ in range(15):
            await lean(pilot, 1, roll=0.1)
            held.add(round(pilot.vehicle.pilot.yaw, 6))
        assert len(held) == 1


@pytest.mark.parametrize("asked", [None, 0.3])
async def test_px4_is_given_the_heading_that_it_has(asked: float | None) -> None:
    puppet = Px4()
    received: list[Any] = []

    def take(message: Any) -> None:
        puppet.setpoints += 1
        received.append(message)

    puppet.on["SET_ATTITUDE_TARGET"] = take
    puppet.also.append(
        lambda: puppet.send("ATTITUDE", puppet.clock, 0.0, 0.0, HEADING, 0.0, 0.0, 0.0)
    )
    async with station(puppet) as found:
        await airborne_px4(found, puppet)
        body = {"pitch": -0.1} | ({} if asked is None else {"yaw": asked})
        reply = await found.write("actuator/attitude", body, valid_for=1.0)
        assert reply["status"] == "completed", reply["error"]
        assert puppet.mode == OFFBOARD
        for message in received:
            w, x, y, z = message.q
            yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            assert yaw == pytest.approx(HEADING if asked is None else asked, abs=1e-3)
            assert message.type_mask == 7


async def test_without_any_heading_it_is_refused_and_nothing_is_sent() -> None:
    puppet = Px4()
    received: list[Any] = []
    puppet.on["SET_ATTITUDE_TARGET"] = received.append
    send = puppet.send

    def blind(name: str, *fields: Any) -> None:
        if name == "GLOBAL_POSITION_INT":
            fields = (*fields[:-1], 65535)
        send(name, *fields)

    puppet.send = blind  # type: ignore[method-assign]
    async with station(puppet) as found:
        await airborne_px4(found, puppet)
        reply = await found.write("actuator/attitude", {"pitch": -0.1})
        assert reply["error"]["code"] == "precondition_failed"
        assert "yaw" in reply["error"]["remedy"]
        assert received == []
        reply = await found.write("actuator/attitude", {"pitch": -0.1, "yaw": 1.0})
        assert received


async def test_a_position_never_received_gives_no_heading_on_a_machine_that_has_just_booted(
    boot: Callable[[], None],
) -> None:
    puppet = Px4()
    async with station(puppet) as found:
        await airborne_px4(found, puppet)
        vehicle = found.robot.vehicle
        puppet.quiet = True
        boot()
        del vehicle.received_at["GLOBAL_POSITION_INT"], vehicle.latest["GLOBAL_POSITION_INT"]
        reply = await found.write("actuator/attitude", {"pitch": -0.1})
        assert reply["error"]["code"] == "precondition_failed", reply


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
