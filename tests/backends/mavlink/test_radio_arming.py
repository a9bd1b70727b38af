"""Sticks arm a vehicle, but not while its remote control is calibrated."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from typing import Any

import pytest

from backends.mavlink.flying import on_the_ground, skip, twin
from backends.mavlink.puppet import Puppet, station
from backends.mavlink.test_equipment import error, estop
from backends.mavlink.test_gateway import KIND, Pilot, flying
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import serve_backend
from rcp_mavlink import restart
from rcp_mavlink_sim import Options, vehicle_of
from rcp_mavlink_sim.modes import Mode

CALIBRATE, GO_ON = "/tenant/t/action/calibrate", "service/calibrate/continue"


@pytest.fixture
async def pilot() -> AsyncIterator[Pilot]:
    async with flying({"parameters": {"DISARM_DELAY": 0.0}}) as found:
        on_the_ground(found.vehicle, Mode.STABILIZE)
        await found.ready()
        yield found


def lower_right(vehicle: Any) -> None:
    """Hold the sticks where they arm it, for 5 simulated seconds."""
    vehicle.sticks.pulses[2:4] = [1050, 1950]
    end = vehicle.time + 5.0
    skip(vehicle, lambda: vehicle.time > end)


async def begun(pilot: Pilot) -> str:
    """Begin, and come to where all sticks are moved."""
    id_ = await pilot.client.send(type="execute", path=CALIBRATE, body={"what": "radio"})
    await asked(pilot, id_, "middle")
    await pilot.do(GO_ON)
    await asked(pilot, id_, "ends")
    return id_


async def asked(pilot: Pilot, id_: str, step: str) -> None:
    while True:
        reply = await pilot.client.reply(id_, 30.0)
        assert reply["status"] in ("accepted", "in_progress"), reply
        if (reply.get("body") or {}).get("position") == step:
            return


def robot(pilot: Pilot) -> Any:
    return pilot.served.life.backend.robots[""]


async def released(pilot: Pilot) -> None:
    flag = pilot.vehicle.calibrations
    await eventually(lambda: _is(not flag.radio), "it is released")


@pytest.mark.parametrize("kind", ["copter", "plane", "rover"])
def test_sticks_arm_the_twin_unless_its_parameter_says_no(kind: Any) -> None:
    vehicle = vehicle_of(Options(vehicle=kind, warmup=0.0))
    vehicle.advance(0.0, 1.0)
    vehicle.params.set("ARMING_RUDDER", 0)
    vehicle.sticks.pulses[0:4] = [1950, 1500, 1500 if kind == "rover" else 1050, 1950]
    end = vehicle.time + 5.0
    skip(vehicle, lambda: vehicle.time > end)
    assert not vehicle.armed
    vehicle.params.set("ARMING_RUDDER", 2)
    skip(vehicle, lambda: vehicle.armed, 5.0)
    vehicle.sticks.pulses[0:4:3] = [1050, 1050]
    skip(vehicle, lambda: not vehicle.armed, 5.0)


async def test_they_do_not_while_its_remote_control_is_calibrated(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    id_ = await begun(pilot)
    lower_right(vehicle)
    assert not vehicle.armed
    refused = await pilot.do("action/arm")
    assert "RC calibrating" in refused["message"]
    vehicle.sticks.pulses[2:4] = [1500, 1500]
    await pilot.client.request("cancel", CALIBRATE)
    assert (await pilot.client.final(id_, 30.0))["status"] == "cancelled"
    await released(pilot)
    lower_right(vehicle)
    assert vehicle.armed, "they do again afterwards"


@pytest.mark.parametrize("end", ["cancel", "link"])
async def test_it_stays_blocked_until_its_sticks_are_let_go(pilot: Pilot, end: str) -> None:
    vehicle = pilot.vehicle
    id_ = await begun(pilot)
    lower_right(vehicle)
    if end == "cancel":
        await pilot.client.request("cancel", CALIBRATE)
        final = await pilot.client.final(id_, 30.0)
        assert "refuses to arm until its sticks are let go" in final["message"]
    else:
        pilot.twin.muted = True
        assert error(await pilot.client.final(id_, 30.0)) == "adapter_unavailable"
        pilot.twin.muted = False
        await eventually(lambda: _is(not robot(pilot).vehicle.lost), "it is back")
    until = vehicle.time + 15.0
    await eventually(lambda: _is(vehicle.time > until), "time has passed")
    assert vehicle.calibrations.radio
    assert not vehicle.armed
    vehicle.sticks.pulses[3] = 1500
    await released(pilot)
    assert not vehicle.armed


async def test_a_vehicle_that_restarts_meanwhile_is_not_calibrated_on(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    vehicle.time += 600.0  # it has run for long, so its clock is seen to begin again
    id_ = await begun(pilot)
    vehicle.reboot()
    final = await pilot.client.final(id_, 30.0)
    assert error(final) == "precondition_failed"
    assert "restarted" in final["message"]


async def test_a_pause_of_the_link_is_no_restart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restart, "_PAUSE", 0.6)
    async with flying({"parameters": {"DISARM_DELAY": 0.0}}, silence=10.0) as pilot:
        on_the_ground(pilot.vehicle, Mode.STABILIZE)
        await pilot.ready()
        id_ = await begun(pilot)
        seen = robot(pilot).vehicle
        pilot.twin.muted = True
        await eventually(lambda: _is(time.monotonic() > seen.last_message_at + 1.0), "it pauses")
        pilot.vehicle.calibrations.radio = False  # somebody else's calibration has ended it
        pilot.twin.muted = False
        flag = pilot.vehicle.calibrations
        await eventually(lambda: _is(flag.radio), "it is blocked anew")
        await pilot.client.request("cancel", CALIBRATE)
        assert (await pilot.client.final(id_, 30.0))["status"] == "cancelled"


async def test_a_lost_link_keeps_it_blocked_until_it_is_back(pilot: Pilot) -> None:
    id_ = await begun(pilot)
    pilot.twin.muted = True
    assert error(await pilot.client.final(id_, 30.0)) == "adapter_unavailable"
    lower_right(pilot.vehicle)
    assert not pilot.vehicle.armed
    pilot.vehicle.sticks.pulses[2:4] = [1500, 1500]
    pilot.twin.muted = False
    await released(pilot)


async def test_an_estop_ends_it_and_the_block_too(pilot: Pilot) -> None:
    id_ = await begun(pilot)
    await estop(pilot)
    assert (await pilot.client.final(id_, 30.0))["status"] != "completed"
    await released(pilot)


async def test_a_gateway_that_ends_takes_the_block_back() -> None:
    async with twin(parameters={"DISARM_DELAY": 0.0}) as running:
        on_the_ground(running.vehicle, Mode.STABILIZE)
        table = {"links": [f"udpout:127.0.0.1:{running.ports[0][1]}"]}
        async with serve_backend(KIND, table) as served:
            await eventually(lambda: _is(served.lives), "it is heard")
            pilot = Pilot(served, running)
            await pilot.ready()
            await begun(pilot)
            assert running.vehicle.calibrations.radio
        assert not running.vehicle.calibrations.radio


async def test_it_does_not_begin_unless_the_vehicle_says_that_it_cannot_be_armed() -> None:
    puppet = Puppet()
    puppet.params = {"RCMAP_YAW": (4.0, 2)}
    pulses = [1500] * 16 + [65535] * 2
    puppet.also.append(lambda: puppet.send("RC_CHANNELS", puppet.clock, 16, *pulses, 255))
    puppet.results |= {241: lambda _: 0, 401: lambda _: 0}
    async with station(puppet) as found:
        await found.robot.parameters.complete.wait()
        reply = await found.do("action/calibrate", {"what": "radio"})
        assert error(reply) == "precondition_failed"
        assert "cannot arm it" in reply["message"]
        told = [command.param4 for command in puppet.commands(241)]
        assert told == [1.0, 0.0], "and it is released"


async def _is(truth: object) -> bool:
    await asyncio.sleep(0)
    return bool(truth)
