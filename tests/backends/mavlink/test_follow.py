"""A target that moves is followed as long as somebody tells where it is."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

import rcp_mavlink
from backends.mavlink.flying import airborne, speed, twin
from backends.mavlink.puppet import station
from backends.mavlink.test_gateway import LAT, LON, Pilot, flying
from backends.mavlink.test_px4 import HOLD, Px4
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import OPERATOR, serve_backend
from rcp_mavlink_sim.modes import Mode

KIND = next(iter(rcp_mavlink.rcp_backends()))
DEGREE = 111_319.49  # m
ON = {"DISARM_DELAY": 0.0, "FOLL_ENABLE": 1.0}
FOLLOWING = 4 << 16 | 8 << 24


@asynccontextmanager
async def follower(**parameters: float) -> AsyncIterator[Pilot]:
    async with flying({"parameters": ON | parameters, "speed": 4.0}) as pilot:
        airborne(pilot.vehicle)
        await pilot.ready()
        await pilot.served.life.backend.robots[""].parameters.complete.wait()
        yield pilot


async def target(pilot: Any, north: float, valid: float = 1.0, east: float = 30.0) -> Any:
    """Write where the target is, m from home, and that it goes to the north."""
    where = {
        "latitude": LAT + north / DEGREE,
        "longitude": LON + east / DEGREE / math.cos(math.radians(LAT)),
        "velocity": {"x": 0.0, "y": 2.0, "z": 0.0},
        "heading": 0.0,
    }
    path = "/tenant/t/actuator/follow_target"
    return await pilot.client.request("write", path, body=where, valid_for=valid)


async def begun(pilot: Pilot, body: Any) -> str:
    id_ = await pilot.client.send(type="execute", path="/tenant/t/action/follow", body=body)
    seen = pilot.served.life.backend.robots[""].vehicle
    await eventually(lambda: _is(seen.mode == "FOLLOW"), "it is seen to follow")
    return id_


async def ended(pilot: Pilot, id_: str) -> Any:
    while (reply := await pilot.client.reply(id_, 60.0))["status"] in ("accepted", "in_progress"):
        pass
    return reply


async def test_a_target_that_is_written_is_followed_at_its_side_for_a_while() -> None:
    async with follower() as pilot:
        assert (await target(pilot, 0.0))["status"] == "completed"
        side = {"distance": 10.0, "angle": math.pi, "height": 15.0}
        id_ = await begun(pilot, {"seconds": 6.0, "side": side})
        for step in range(35):
            await target(pilot, step * 0.4)
            await asyncio.sleep(0.2)
        reply = await ended(pilot, id_)
        assert reply["status"] == "completed", reply
        assert reply["body"]["age"] < 1.0
        vehicle = pilot.vehicle
        assert vehicle.flight.mode is Mode.BRAKE
        p = vehicle.params
        assert (p["FOLL_OFS_X"], p["FOLL_OFS_TYPE"], p["FOLL_OFS_Z"]) == (-10.0, 1.0, -15.0)
        assert vehicle.body.e == pytest.approx(30.0, abs=3.0)
        assert -vehicle.body.d == pytest.approx(15.0, abs=2.0)


async def test_a_target_that_is_lost_ends_it_with_a_hold() -> None:
    async with follower() as pilot:
        await target(pilot, 10.0, valid=0.6)
        id_ = await begun(pilot, None)
        reply = await ended(pilot, id_)
        assert (reply["status"], reply["error"]["code"]) == ("failed", "device_rejected")
        assert "the target was lost" in reply["message"]
        assert reply["message"].endswith("the vehicle was commanded to hold"), "and that is all"
        assert "on_loss" not in (reply["error"].get("details") or {})
        vehicle = pilot.vehicle
        await eventually(lambda: _is(vehicle.flight.mode is Mode.BRAKE), "it holds")
        await eventually(lambda: _is(speed(vehicle) < 0.3), "it is at rest")
        again = await pilot.do("action/follow")
        assert again["error"]["code"] == "precondition_failed", "a lost target is none"


async def test_one_that_is_too_far_away_is_lost_and_a_cancel_holds() -> None:
    async with follower() as pilot:
        await target(pilot, 500.0, valid=30.0)
        far = await pilot.do("action/follow")
        assert far["error"]["code"] == "device_rejected"
        assert "FOLL_DIST_MAX, 100 m" in far["message"]
        await target(pilot, 20.0, valid=30.0)
        id_ = await begun(pilot, None)
        await pilot.client.request("cancel", "/tenant/t/action/follow")
        assert (await ended(pilot, id_))["status"] == "cancelled"
        assert pilot.vehicle.flight.mode is Mode.BRAKE
        id_ = await begun(pilot, None)
        pilot.vehicle.flight.set_mode(Mode.LOITER)  # a pilot takes over
        taken = await ended(pilot, id_)
        assert taken["error"]["code"] == "device_rejected"
        assert pilot.vehicle.flight.mode is Mode.LOITER, "nobody takes it from the pilot"


@pytest.mark.parametrize(
    ("parameters", "why"),
    [({"FOLL_ENABLE": 0.0}, "FOLL_ENABLE is not 1"), ({"FOLL_SYSID": 7.0}, "system 7 only")],
)
async def test_a_vehicle_that_would_not_follow_is_not_told_to(
    parameters: dict[str, float], why: str
) -> None:
    async with follower(**parameters) as pilot:
        nobody = await pilot.do("action/follow")
        assert "nobody tells where the target is" in nobody["message"]
        await target(pilot, 10.0, valid=30.0)
        reply = await pilot.do("action/follow")
        assert reply["error"]["code"] == "precondition_failed"
        assert why in reply["message"]
        assert pilot.vehicle.flight.mode is Mode.GUIDED
        half = await pilot.client.request(
            "write", "/tenant/t/actuator/follow_target", body={"latitude": 1.0}
        )
        assert half["error"]["code"] == "invalid_value"


async def test_a_vehicle_that_hears_another_system_or_falls_does_not_follow() -> None:
    async with follower() as pilot:
        await target(pilot, 10.0, valid=30.0)
        pilot.vehicle.params.set("FOLL_SYSID", 7)  # as an ArduPilot does that heard it first
        other = await pilot.do("action/follow", {"seconds": 1.0})
        assert "system 7 only" in str(other.get("message"))
        pilot.vehicle.params.set("FOLL_SYSID", 0)
        id_ = await begun(pilot, {"seconds": 3.0})
        pilot.vehicle.flight.disarm(21196.0)
        fallen = await ended(pilot, id_)
        assert fallen["error"]["code"] == "device_rejected"
        assert "disarmed" in fallen["message"] or "on the ground" in fallen["message"]


async def test_a_lost_link_ends_it_and_the_vehicle_stops_by_itself() -> None:
    async with follower() as pilot:
        await target(pilot, 10.0, valid=60.0)
        id_ = await begun(pilot, None)
        pilot.twin.muted = True
        reply = await ended(pilot, id_)
        assert reply["error"]["code"] == "adapter_unavailable"
        await eventually(lambda: _is(speed(pilot.vehicle) < 0.3), "it stops without its target")
        pilot.twin.muted = False
        await eventually(lambda: _is(pilot.vehicle.flight.mode is Mode.BRAKE), "`on_loss` holds it")


async def test_another_vehicle_of_the_backend_is_followed_until_it_is_lost() -> None:
    async with (
        twin(parameters=ON, speed=4.0) as own,
        twin(system=2, speed=4.0, home=(LAT, LON + 2e-4, 584.0)) as other,
    ):
        airborne(own.vehicle)
        airborne(other.vehicle)
        links = [f"udpout:127.0.0.1:{each.ports[0][1]}" for each in (own, other)]
        table = {"links": links, "discover": True, "silence": 1.5, "feedback_timeout": 2.0}
        async with serve_backend(KIND, table) as served:
            await eventually(
                lambda: _is(bool(served.lives) and len(served.life.backend.robots) == 2), "both"
            )
            robots = served.life.backend.robots
            await robots["vehicle1"].parameters.complete.wait()
            await eventually(
                lambda: _is(
                    all(r.vehicle.landed is False and r.vehicle.home for r in robots.values())
                ),
                "both fly",
            )
            client = served.client(OPERATOR)
            path = "/tenant/t/action/vehicle1/follow"
            for name in ("vehicle1", "nobody"):
                odd = await client.request("execute", path, body={"vehicle": name}, within=60.0)
                assert odd["error"]["details"]["pointer"] == "/vehicle"
            written = {"latitude": LAT, "longitude": LON - 5e-4}
            where = "/tenant/t/actuator/vehicle1/follow_target"
            await client.request("write", where, body=written, valid_for=1.0)
            body = {"vehicle": "vehicle2", "side": {"distance": 8.0, "angle": 0.0}}
            id_ = await client.send(type="execute", path=path, body=body)
            other.vehicle.flight.aim((25.0, 0.0), -20.0)
            await eventually(
                lambda: _is(other.vehicle.body.n > 24 and abs(own.vehicle.body.n - 25) < 12),
                "it goes where the other goes",
            )
            assert own.vehicle.flight.mode is Mode.FOLLOW
            refused = await client.request("write", where, body=written)
            assert refused["error"]["code"] == "precondition_failed", "one target at a time"
            other.muted = True
            hung = asyncio.create_task(repeated(robots["vehicle2"].vehicle))
            while (reply := await client.reply(id_, 60.0))["status"] in ("accepted", "in_progress"):
                pass
            hung.cancel()
            assert reply["error"]["code"] == "device_rejected"
            assert own.vehicle.flight.mode is Mode.BRAKE


async def repeated(vehicle: Any) -> None:
    """Repeat its last position, as a hung process does."""
    frame = vehicle.latest["GLOBAL_POSITION_INT"]
    while True:
        vehicle.take(frame, time.monotonic())
        await asyncio.sleep(0.1)


class Px4Follower(Px4):
    def __init__(self) -> None:
        super().__init__()
        self.params |= {"FLW_TGT_DST": (8.0, 9), "FLW_TGT_FA": (180.0, 9), "FLW_TGT_HT": (8.0, 9)}
        self.params |= {
            "GF_ACTION": (0.0, 6),
            "GF_MAX_HOR_DIST": (0.0, 9),
            "GF_MAX_VER_DIST": (0.0, 9),
        }
        self.mode, self.armed, self.landed, self.height = HOLD, True, 2, 20.0


async def test_px4_follows_in_its_own_mode_with_its_own_parameters() -> None:
    puppet = Px4Follower()
    async with station(puppet) as found:
        await found.robot.parameters.complete.wait()
        vehicle = found.robot.vehicle
        await eventually(lambda: _is(vehicle.landed is False and vehicle.home is not None), "aloft")
        where = {"latitude": 47.0002, "longitude": 8.0, "altitude": 5.0, "heading": 1.5}
        await found.write("actuator/follow_target", where, valid_for=30.0)
        side = {"distance": 12.0, "angle": -1.0, "height": 3.0}
        reply = await found.do("action/follow", {"seconds": 1.0, "side": side})
        assert reply["status"] == "completed", reply
        values = {name: value for name, (value, _) in puppet.params.items()}
        assert values["FLW_TGT_DST"] == 12.0
        assert values["FLW_TGT_FA"] == pytest.approx(math.degrees(-1.0))
        assert values["FLW_TGT_HT"] == 8.0, "PX4 follows no lower"
        modes = [int(c.param2) << 16 | int(c.param3) << 24 for c in puppet.commands(176)]
        assert modes[0] == FOLLOWING
        assert puppet.mode == HOLD
        told = puppet.messages("FOLLOW_TARGET")[0]
        assert (told.lat, told.alt, told.est_capabilities) == (470002000, 405.0, 1 | 8)
        assert told.attitude_q[3] == pytest.approx(math.sin(0.75))


async def _is(truth: object) -> bool:
    return bool(truth)
