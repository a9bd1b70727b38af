"""A vehicle that follows keeps to its speed limit and its fences, wherever its target goes."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from backends.mavlink.flying import airborne, speed, twin
from backends.mavlink.puppet import Station, station
from backends.mavlink.test_equipment import estop
from backends.mavlink.test_follow import DEGREE, KIND, ON, Px4Follower, ended, target
from backends.mavlink.test_gateway import LAT, LON, Pilot, flying
from backends.mavlink.test_px4 import HOLD
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import OPERATOR, serve
from rcp_mavlink import follow_limits
from rcp_mavlink_sim.modes import Mode

FOLLOW, LIMIT = "/tenant/t/action/follow", "/tenant/t/param/speed_limit"
INCLUSION = 5001
_STEP = 0.1  # s between two positions of the target
_AT_REST = 0.3  # m/s


@asynccontextmanager
async def follower(**parameters: float) -> AsyncIterator[Pilot]:
    given = ON | {"FOLL_OFS_X": -5.0, "FOLL_OFS_TYPE": 1.0} | parameters
    async with flying({"parameters": given, "speed": 1.0}) as pilot:
        await ready(pilot)
        yield pilot


async def ready(pilot: Pilot) -> None:
    airborne(pilot.vehicle)
    await pilot.ready()
    await pilot.served.life.backend.robots[""].parameters.complete.wait()


@asynccontextmanager
async def leading(pilot: Any, pace: float, start: float = 5.0) -> AsyncGenerator[None]:
    """Have the target go north at a pace (m/s), until left."""

    async def go() -> None:
        north = start
        while True:
            where = {"latitude": LAT + north / DEGREE, "longitude": LON, "heading": 0.0}
            where["velocity"] = {"x": 0.0, "y": pace, "z": 0.0}
            path = "/tenant/t/actuator/follow_target"
            await pilot.client.request("write", path, body=where, valid_for=2.0)
            await asyncio.sleep(_STEP)
            north += pace * _STEP * pilot.vehicle.options.speed

    await target(pilot, start, east=0.0)
    task = asyncio.create_task(go())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def stays_at_rest(pilot: Pilot) -> None:
    """Wait until it is at rest, and see that it stays there although the target goes on."""
    vehicle = pilot.vehicle
    await eventually(lambda: _is(speed(vehicle) < _AT_REST), "it is at rest")
    at, until = (vehicle.body.n, vehicle.body.e), vehicle.time + 4.0
    await eventually(lambda: _is(vehicle.time > until), "time has passed")
    assert math.dist(at, (vehicle.body.n, vehicle.body.e)) < 2.0
    assert vehicle.flight.mode is Mode.BRAKE


async def fenced(pilot: Pilot) -> None:
    seen = pilot.served.life.backend.robots[""].vehicle

    def is_told() -> bool:
        frame = seen.latest.get("SYS_STATUS")
        return frame is not None and bool(
            frame.fields()["onboard_control_sensors_enabled"] & 1 << 20
        )

    await eventually(lambda: _is(is_told()), "the fence is seen")


async def test_a_target_that_is_too_fast_is_followed_at_the_limit_which_may_change() -> None:
    async with follower(WPNAV_SPEED=300.0, FOLL_DIST_MAX=0.0) as pilot, leading(pilot, 8.0):
        fastest = 0.0
        id_ = await pilot.client.send(type="execute", path=FOLLOW, body={"seconds": 10.0})
        limited = list[str]()
        changed = False
        while (reply := await pilot.client.reply(id_, 30.0))["status"] in (
            "accepted",
            "in_progress",
        ):
            fastest = max(fastest, speed(pilot.vehicle))
            told = (reply.get("body") or {}).get("limited")
            limited += [told] if told else []
            if not changed and speed(pilot.vehicle) > 2.5:
                assert fastest < 3.6
                done = await pilot.client.request("write", LIMIT, body=1.5)
                assert done["status"] == "completed", done
                changed = True
        assert reply["status"] == "completed", reply
        assert limited[0] == "the target moves at 8.0 m/s, the speed limit is 3 m/s"
        assert reply["body"]["limited"].endswith("the speed limit is 1.5 m/s")
        assert fastest < 3.6
        await stays_at_rest(pilot)


def area(north: float) -> list[dict[str, Any]]:
    """Return a fence that ends north of home, m."""
    corners = ((-60.0, -60.0), (-60.0, 60.0), (north, 60.0), (north, -60.0))
    east = DEGREE * math.cos(math.radians(LAT))
    return [
        {"command": "NAV_FENCE_POLYGON_VERTEX_INCLUSION", "params": [4],
         "latitude": LAT + n / DEGREE, "longitude": LON + e / east}
        for n, e in corners
    ]  # fmt: skip


@pytest.mark.parametrize("kind", ["circle", "polygon"])
async def test_a_target_that_leaves_the_fence_is_followed_up_to_it(kind: str) -> None:
    more = {"circle": {"FENCE_RADIUS": 40.0}, "polygon": {"FENCE_TYPE": 4.0}}[kind]
    async with follower(FENCE_ACTION=1.0, **more) as pilot:
        vehicle = pilot.vehicle
        if kind == "polygon":
            done = await pilot.do("service/fence/upload", {"items": area(40.0)})
            assert done["status"] == "completed", done
        vehicle.params.set("FENCE_ENABLE", 1)
        await fenced(pilot)
        async with leading(pilot, 4.0):
            reply = await pilot.do("action/follow")
            assert reply["error"]["code"] == "device_rejected", reply
            assert "the target leads on" in reply["message"]
            assert "commanded to hold" in reply["message"]
            assert reply["error"]["details"]["fence"]
            await stays_at_rest(pilot)
        assert vehicle.fence.count == 0, "the vehicle itself had no reason to act"
        assert 20.0 < vehicle.body.n < 40.0


async def test_it_does_not_begin_outside_the_fence() -> None:
    async with follower(FENCE_ACTION=0.0, FENCE_RADIUS=30.0) as pilot:
        pilot.vehicle.body.n = 35.0
        pilot.vehicle.params.set("FENCE_ENABLE", 1)
        await fenced(pilot)
        seen = pilot.served.life.backend.robots[""].vehicle
        away = 30.0 / DEGREE
        await eventually(lambda: _is(seen.fix and seen.fix.lat > LAT + away), "it is seen there")
        async with leading(pilot, 0.0, 20.0):
            reply = await pilot.do("action/follow")
        assert reply["error"]["code"] == "device_rejected"
        assert "FENCE_RADIUS" in reply["message"]
        assert pilot.vehicle.flight.mode is Mode.GUIDED


async def test_one_that_ignores_its_speed_limit_is_told_to_hold() -> None:
    puppet = Px4Follower()
    puppet.params["MPC_XY_VEL_MAX"] = (3.0, 9)
    puppet.also.append(lambda: setattr(puppet, "velocity", (9.0, 0.0, 0.0)))
    async with station(puppet) as found:
        await found.robot.parameters.complete.wait()
        vehicle = found.robot.vehicle
        await eventually(lambda: _is(vehicle.landed is False and vehicle.home), "aloft")
        where = {"latitude": 47.0002, "longitude": 8.0}
        await found.write("actuator/follow_target", where, valid_for=60.0)
        reply = await found.do("action/follow")
        assert reply["error"]["code"] == "device_rejected", reply
        assert "3 m/s requested, but it moves at 9.0 m/s" in reply["message"]


async def test_a_hold_that_is_refused_then_is_not_told_as_one() -> None:
    puppet = Px4Follower()
    puppet.params["MPC_XY_VEL_MAX"] = (3.0, 9)
    async with aloft(puppet) as found:
        await found.robot.parameters.complete.wait()
        id_ = await found.client.send(type="execute", path=FOLLOW, body=None)
        await eventually(lambda: _is(found.robot.vehicle.mode == "FOLLOW"), "it follows")
        puppet.results[176] = lambda _: 4
        puppet.also.append(lambda: setattr(puppet, "velocity", (9.0, 0.0, 0.0)))
        reply = await ended(found, id_)
        assert reply["error"]["code"] == "device_timeout", reply
        assert "commanded to hold, which it has not confirmed" in reply["message"]


class Fenced(Px4Follower):
    """It flies north in a fence round its home, without areas."""

    def __init__(self, action: float = 2.0) -> None:
        super().__init__()
        self.params |= {"GF_ACTION": (action, 6), "GF_MAX_HOR_DIST": (3.2, 9)}
        self.params["MPC_XY_VEL_MAX"] = (2.0, 9)
        self.velocity = (2.0, 0.0, 0.0)
        self.also.append(lambda: setattr(self, "velocity", (2.0, 0.0, 0.0)))
        self.pauses = False
        self.on["MISSION_REQUEST_LIST"] = lambda _: self.send("MISSION_COUNT", 255, 190, 0, 1)

    def send(self, name: str, *fields: Any) -> None:
        if not (self.pauses and name == "GLOBAL_POSITION_INT"):
            super().send(name, *fields)


@asynccontextmanager
async def aloft(puppet: Px4Follower) -> AsyncGenerator[Station]:
    async with station(puppet) as found:
        vehicle = found.robot.vehicle
        await eventually(lambda: _is(vehicle.landed is False and vehicle.home), "aloft")
        where = {"latitude": 47.0002, "longitude": 8.0}
        await found.write("actuator/follow_target", where, valid_for=60.0)
        yield found


async def test_nothing_is_followed_while_parameters_are_not_listed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(follow_limits, "_LISTING", 0.3)
    puppet = Fenced()
    puppet.tell = lambda name: puppet.send("PARAM_VALUE", name.encode(), 0.0, 9, 1000, 0)
    async with aloft(puppet) as found:
        reply = await found.do("action/follow")
        assert reply["error"]["code"] == "precondition_failed", reply
        assert "not listed yet, so its fence is not known" in reply["message"]
        assert not puppet.commands(176)


@pytest.mark.parametrize("name", ["GF_ACTION", "GF_MAX_HOR_DIST"])
async def test_nothing_is_followed_without_the_parameters_of_a_fence(name: str) -> None:
    puppet = Fenced()
    del puppet.params[name]
    async with aloft(puppet) as found:
        await found.robot.parameters.complete.wait()
        reply = await found.do("action/follow")
        assert reply["error"]["code"] == "precondition_failed", reply
        assert name in reply["message"]


async def test_an_ardupilot_neither() -> None:
    async with follower() as pilot:
        pilot.vehicle.params.set("FENCE_ENABLE", 1)
        await fenced(pilot)
        await target(pilot, 5.0)
        robot = pilot.served.life.backend.robots[""]
        for name in ("FENCE_RADIUS", "FENCE_ALT_MAX", "FENCE_TYPE"):
            kept = robot.parameters.known.pop(name)
            reply = await pilot.do("action/follow")
            assert reply["error"]["code"] == "precondition_failed", reply
            assert name in reply["message"]
            robot.parameters.known[name] = kept


@pytest.mark.parametrize("action", [1.0, 2.0])
async def test_it_holds_inside_although_positions_pause(action: float) -> None:
    puppet = Fenced(action)
    async with aloft(puppet) as found:
        await found.robot.parameters.complete.wait()
        id_ = await found.client.send(type="execute", path=FOLLOW, body=None)
        await eventually(lambda: _is(found.robot.vehicle.mode == "FOLLOW"), "it follows")
        puppet.pauses = True
        reply = await ended(found, id_)
        assert reply["error"]["code"] == "device_rejected", reply
        assert "GF_MAX_HOR_DIST 3.2 m" in reply["message"]
        assert puppet.mode == HOLD


async def test_a_fence_with_areas_that_is_enabled_meanwhile_ends_it() -> None:
    async with follower(FENCE_TYPE=4.0) as pilot, leading(pilot, 1.0):
        id_ = await pilot.client.send(type="execute", path=FOLLOW, body=None)
        await eventually(lambda: _is(speed(pilot.vehicle) > 0.5), "it follows")
        pilot.vehicle.params.set("FENCE_ENABLE", 1)
        reply = await ended(pilot, id_)
        assert "was enabled meanwhile, and its areas are not known" in reply["message"], reply
        assert "leads on" not in reply["message"]
        assert reply["error"]["remedy"].startswith("Follow again"), reply


async def test_so_does_one_whose_limits_come_to_be_unknown() -> None:
    async with follower(FENCE_TYPE=1.0) as pilot, leading(pilot, 1.0):
        id_ = await pilot.client.send(type="execute", path=FOLLOW, body=None)
        await eventually(lambda: _is(speed(pilot.vehicle) > 0.5), "it follows")
        del pilot.served.life.backend.robots[""].parameters.known["FENCE_ALT_MAX"]
        pilot.vehicle.params.set("FENCE_ENABLE", 1)
        reply = await ended(pilot, id_)
        assert "the parameter FENCE_ALT_MAX of its fence is not known" in reply["message"], reply
        assert reply["error"]["remedy"].startswith("Follow again"), reply


@pytest.mark.parametrize("by", ["estop", "lease"])
async def test_a_stop_and_a_lost_lease_end_it_at_rest(by: str) -> None:
    async with follower() as pilot, leading(pilot, 4.0):
        lease = {"do": "acquire", "scope": "/tenant/t", "ttl": 1.5}
        held = await pilot.client.request("execute", "/system/leases", body=lease)
        assert held["status"] == "completed", held
        id_ = await pilot.client.send(type="execute", path=FOLLOW, body=None)
        await eventually(lambda: _is(speed(pilot.vehicle) > 1.5), "it follows")
        if by == "estop":
            await estop(pilot)
        final = await ended(pilot, id_)
        assert final["status"] == "cancelled", final
        await stays_at_rest(pilot)


CONFIG = """
[[keys]]
name = "operator"
role = "operator"
key = "{key}"

[[backends]]
use = "mavlink"
tenant = "t"
links = ["{link}"]
silence = 1.5
feedback_timeout = 5.0

[[envelopes]]
name = "field"
paths = ["/action/follow"]
fence = {{ of = "sensor/pose", inside = {{ field = [[-60, -60], [60, -60], [60, 20], [-60, 20]] }} }}
"""


async def test_a_fence_of_the_gateway_ends_it_at_rest() -> None:
    given = ON | {"FOLL_OFS_X": -5.0, "FOLL_OFS_TYPE": 1.0}
    async with twin(parameters=given, speed=1.0) as running:
        link = f"udpout:127.0.0.1:{running.ports[0][1]}"
        async with serve(CONFIG.format(key=OPERATOR, link=link), KIND) as served:
            await eventually(lambda: _is(served.lives), "it is heard")
            pilot = Pilot(served, running)
            await ready(pilot)
            async with leading(pilot, 3.0):
                id_ = await pilot.client.send(type="execute", path=FOLLOW, body=None)
                notice = await pilot.client.notice("fence_left")
                assert "field" in str(notice)
                assert (await ended(pilot, id_))["status"] == "cancelled"
                await stays_at_rest(pilot)
                again = await pilot.do("action/follow")
                assert again["error"]["code"] == "out_of_range"


async def _is(truth: object) -> bool:
    return bool(truth)
