"""Calibrations: followed step by step, done when the vehicle says so, and never while it is armed."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from backends.mavlink.flying import armed, on_the_ground
from backends.mavlink.test_equipment import error
from backends.mavlink.test_gateway import Pilot, flying
from backends.mavlink.test_px4 import px4
from rcp_gateway.testing import eventually

PATH = "/tenant/t/action/calibrate"


@pytest.fixture
async def pilot() -> AsyncIterator[Pilot]:
    async with flying() as found:
        on_the_ground(found.vehicle)
        await found.ready()
        yield found


async def test_the_compasses_are_calibrated_while_it_is_turned(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    id_ = await pilot.client.send(type="execute", path=PATH, body={"what": "compass"})
    await eventually(lambda: _is(vehicle.calibrations.mask == 0b11), "it has begun")
    vehicle.params.set("SIM_TURNED", 1)
    parts = []
    while (reply := await pilot.client.reply(id_, 30.0))["status"] in ("accepted", "in_progress"):
        parts.append(reply.get("progress") or 0.0)
    assert reply["status"] == "completed", reply
    assert parts == sorted(parts)
    assert [text.partition(":")[0] for text in reply["body"]["texts"]] == ["compass 1", "compass 2"]
    assert vehicle.params["COMPASS_OFS2_Z"] == 31.0


async def test_a_cancelled_compass_calibration_is_cancelled_on_board(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    id_ = await pilot.client.send(type="execute", path=PATH, body={"what": "compass"})
    await eventually(lambda: _is(vehicle.calibrations.mask != 0), "it has begun")
    await pilot.client.request("cancel", PATH)
    assert (await pilot.client.final(id_, 30.0))["status"] == "cancelled"
    assert vehicle.calibrations.mask == 0


@pytest.mark.parametrize("careless", [False, True])
async def test_six_positions_are_asked_for_one_by_one(pilot: Pilot, *, careless: bool) -> None:
    vehicle = pilot.vehicle
    early = await pilot.do("service/calibrate/continue")
    assert error(early) == "precondition_failed"
    id_ = await pilot.client.send(type="execute", path=PATH, body={"what": "accelerometer_full"})
    asked = list[str]()
    for position in range(1, 7):
        while True:
            reply = await pilot.client.reply(id_, 30.0)
            feedback = reply.get("body") or {}
            if feedback.get("position") and feedback["position"] not in asked:
                break
            assert reply["status"] in ("accepted", "in_progress"), reply
        asked.append(feedback["position"])
        assert "service/calibrate/continue" in feedback["text"]
        vehicle.params.set("SIM_POSTURE", 1 if careless else position)
        done = await pilot.do("service/calibrate/continue")
        assert done["status"] == "completed", done
    final = await pilot.client.final(id_, 30.0)
    assert asked[0] == "level"
    if careless:
        assert error(final) == "device_rejected", "it lay still all the time"
    else:
        assert final["status"] == "completed", final
        assert final["body"]["texts"] == asked


async def test_nothing_is_calibrated_while_it_is_armed(pilot: Pilot) -> None:
    armed(pilot.vehicle)
    await pilot.ready()
    for what in ("gyro", "level", "compass", "accelerometer_full"):
        assert error(await pilot.do("action/calibrate", {"what": what})) == "precondition_failed"
    assert pilot.vehicle.calibrations.mask == pilot.vehicle.calibrations.position == 0


@pytest.mark.parametrize("end", ["calibration done: mag", "calibration failed: timeout"])
async def test_a_px4_tells_it_in_texts(end: str) -> None:
    async with px4() as (found, puppet):
        puppet.results[241] = lambda _: 0
        ask = asyncio.create_task(found.do("action/calibrate", {"what": "compass"}))
        await eventually(lambda: _is(bool(puppet.commands(241))), "it is told")
        for words in (
            "calibration started: 2 mag",
            "down orientation detected",
            "progress <50>",
            end,
        ):
            puppet.say(f"[cal] {words}", 6)
        reply = await ask
        assert puppet.commands(241)[0].param2 == 1
        if "failed" in end:
            assert error(reply) == "device_rejected"
            assert end in reply["message"]
        else:
            assert reply["status"] == "completed", reply
            assert reply["body"]["texts"][-1] == end


async def test_a_cancel_is_told_to_a_px4() -> None:
    async with px4() as (found, puppet):
        puppet.results[241] = lambda _: 0
        id_ = await found.client.send(type="execute", path=PATH, body={"what": "gyro"})
        await eventually(lambda: _is(len(puppet.commands(241)) == 1), "it is told")
        await found.client.request("cancel", PATH)
        assert (await found.client.final(id_, 30.0))["status"] == "cancelled"
        assert _sensors(puppet.commands(241)[-1]) == (0.0,) * 6


def _sensors(command: Any) -> tuple[float, ...]:
    return tuple(getattr(command, f"param{n}") for n in range(1, 7))


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
