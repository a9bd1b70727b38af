"""The simulated PX4 beside its flights: calibrations, its geofence, and what it tells of itself."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from typing import Any

import pytest

from backends.mavlink.flying import speed
from backends.mavlink.test_equipment import error
from backends.mavlink.test_metadata import schema_of
from backends.mavlink.test_px4_twin import DEGREE, LAT, LON, Px4Pilot, px4
from rcp_gateway.testing import eventually
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.parameters_table import settable
from rcp_mavlink_sim.px4.flight import HOLD

CALIBRATE = "/tenant/t/action/calibrate"
SIDES = {"down": 1, "left": 2, "right": 3, "front": 4, "back": 5, "up": 6}
"""`SIM_POSTURE` for the side that points down."""


@pytest.fixture
async def pilot() -> AsyncIterator[Px4Pilot]:
    async with px4(up=False) as found:
        yield found


async def calibrated(pilot: Px4Pilot, what: str, turns: dict[str, float]) -> tuple[Any, list[Any]]:
    """Calibrate, and turn the vehicle to a side that it asks for; return all feedback too."""
    params, heard = pilot.vehicle.params, list[Any]()
    id_ = await pilot.client.send(type="execute", path=CALIBRATE, body={"what": what})
    while (reply := await pilot.client.reply(id_, 60.0))["status"] in ("accepted", "in_progress"):
        told = reply.get("body") or {}
        heard.append((told.get("text", ""), reply.get("progress")))
        name, _, left = told.get("text", "").partition(": ")
        if name == "pending":
            params.set("SIM_TURNED", 0)
            params.set("SIM_POSTURE", SIDES[left.split()[0]])
        elif told.get("text") in turns:
            params.set("SIM_TURNED", turns[told["text"]])
    return reply, heard


@pytest.mark.parametrize("what", ["gyro", "level", "barometer", "accelerometer"])
async def test_what_needs_no_turning_is_calibrated_at_rest(pilot: Px4Pilot, what: str) -> None:
    reply, heard = await calibrated(pilot, what, {})
    assert reply["status"] == "completed", reply
    assert heard[-1][0].startswith("calibration done")


@pytest.mark.parametrize(
    ("what", "turns"), [("accelerometer_full", {}), ("compass", {"Rotate vehicle": 1.0})]
)
async def test_six_sides_are_asked_for_and_seen(
    pilot: Px4Pilot, what: str, turns: dict[str, float]
) -> None:
    reply, heard = await calibrated(pilot, what, turns)
    assert reply["status"] == "completed", reply
    texts = [text for text, _ in heard]
    assert texts.count("hold vehicle still on a pending side") == 6
    assert {f"{side} orientation detected" for side in SIDES} <= set(texts)
    parts = [part for _, part in heard if part is not None]
    assert parts == sorted(parts)
    assert len(set(parts)) > 5
    assert parts[-1] > 0.9
    sensor = "ACC" if what == "accelerometer_full" else "MAG"
    assert pilot.vehicle.params[f"CAL_{sensor}0_XOFF"] == pytest.approx(0.02)


async def test_a_vehicle_that_nobody_turns_fails_and_one_in_calibration_does_not_arm(
    pilot: Px4Pilot,
) -> None:
    id_ = await pilot.client.send(type="execute", path=CALIBRATE, body={"what": "compass"})
    calibrations = pilot.vehicle.calibrations
    await eventually(lambda: _is(calibrations.what == "mag"), "it has begun")
    assert "Arming denied: calibrating" in (await pilot.do("action/arm"))["message"]
    final = await pilot.client.final(id_, 60.0)
    assert error(final) == "device_rejected"
    assert "timeout: no motion" in final["message"]
    id_ = await pilot.client.send(type="execute", path=CALIBRATE, body={"what": "compass"})
    await eventually(lambda: _is(calibrations.what == "mag"), "it has begun again")
    await pilot.client.request("cancel", CALIBRATE)
    assert (await pilot.client.final(id_, 30.0))["status"] == "cancelled"
    assert calibrations.what is None
    assert (await pilot.do("action/arm"))["status"] == "completed"
    assert error(await pilot.do("action/calibrate", {"what": "gyro"})) == "precondition_failed"


def area(size: float) -> list[dict[str, Any]]:
    """Return a square around home as a fence, with half its side, m."""
    east = DEGREE * math.cos(math.radians(LAT))
    return [
        {"command": "NAV_FENCE_POLYGON_VERTEX_INCLUSION", "params": [4],
         "latitude": LAT + n * size / DEGREE, "longitude": LON + e * size / east}
        for n, e in ((-1, -1), (-1, 1), (1, 1), (1, -1))
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("action", "mode"), [(1, Mode.LOITER), (2, HOLD), (3, Mode.RTL), (5, Mode.LAND)]
)
async def test_what_leaves_its_fence_does_as_its_parameter_says(action: int, mode: Mode) -> None:
    async with px4(parameters={"GF_ACTION": float(action)}) as pilot:
        vehicle = pilot.vehicle
        uploaded = await pilot.do("service/fence/upload", {"items": area(30.0)})
        assert uploaded["body"] == {"count": 4}
        read = (await pilot.do("service/fence/download"))["body"]["items"]
        assert [item["command"] for item in read] == ["NAV_FENCE_POLYGON_VERTEX_INCLUSION"] * 4
        vehicle.flight.enter(Mode.LOITER)  # flown by hand
        vehicle.pilot.place, vehicle.pilot.velocity = None, (4.0, 0.0)
        await eventually(lambda: _is(vehicle.body.n > 31), "it has left the fence")
        await eventually(lambda: _is(vehicle.flight.mode is mode), "it does as it should")
        assert vehicle.fence.count == 1
        texts = pilot.served.life.backend.robots[""].vehicle.texts
        await eventually(
            lambda: _is(any("Geofence exceeded" in text.text for text in texts)), "it says so"
        )


async def test_targets_outside_a_fence_that_only_warns_are_flown_to() -> None:
    async with px4(parameters={"GF_ACTION": 1.0, "GF_MAX_HOR_DIST": 15.0}) as pilot:
        await pilot.served.life.backend.robots[""].parameters.complete.wait()
        reply = await pilot.do("action/move_to", {"north": 20.0})
        assert reply["status"] == "completed", reply
        assert pilot.vehicle.fence.count == 1, "it has warned"


async def test_targets_outside_the_fence_are_refused_before_and_after_it_accepts_them() -> None:
    given = {"GF_ACTION": 2.0, "GF_MAX_HOR_DIST": 60.0, "GF_MAX_VER_DIST": 50.0}
    async with px4(parameters=given) as pilot:
        await pilot.served.life.backend.robots[""].parameters.complete.wait()
        for goal, why in (
            ({"north": 90.0}, "90 m from home is outside the fence, GF_MAX_HOR_DIST 60 m"),
            ({"altitude": 70.0}, "70 m above home is above the fence, GF_MAX_VER_DIST 50 m"),
        ):
            reply = await pilot.do("action/move_to", goal)
            assert error(reply) == "device_rejected"
            assert why in reply["message"]
        await pilot.do("service/fence/upload", {"items": area(20.0)})
        reply = await pilot.do("action/move_to", {"north": 40.0})
        assert error(reply) == "device_rejected", reply
        assert "Reposition is outside geofence" in reply["message"]
        assert speed(pilot.vehicle) < 0.3
        assert (await pilot.do("action/move_to", {"north": 10.0}))["status"] == "completed"


async def test_names_units_and_groups_of_parameters_come_from_the_vehicle() -> None:
    async with px4(up=False, table={"parameters": "vehicle"}) as pilot:
        entry = str(await schema_of(pilot, "GF_MAX_HOR_DIST"))
        assert "Farthest from home, 0 for no limit." in entry
        assert "'unit': 'm'" in entry
        assert "'group': 'Geofence'" in entry
        assert "Return mode" in str(await schema_of(pilot, "GF_ACTION"))
        listed = await pilot.do("service/ftp/list", {"path": "/etc/extras"})
        names = [each["name"] for each in listed["body"]]
        assert names == [
            "actuators.json.xz", "all_events.json.xz", "component_general.json.xz",
            "parameters.json.xz",
        ]  # fmt: skip
        with_data = {"path": "/etc/extras/mine.json", "offset": 0, "data": "e30="}
        written = await pilot.do("service/ftp/write", with_data)
        assert error(written) == "device_rejected", "it is part of the firmware"


def test_it_starts_with_parameters_of_the_simulation_too() -> None:
    assert settable("px4") >= {"SIM_GPS1_ENABLE", "GF_ACTION"}
    assert "FENCE_ENABLE" not in settable("px4")


async def _is(truth: object) -> bool:
    return bool(truth)
