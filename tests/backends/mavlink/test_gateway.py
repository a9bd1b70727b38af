"""A vehicle flown through the gateway alone."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

import rcp_mavlink
from backends.mavlink.flying import agrees, airborne, on_the_ground, speed, twin
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import ADMIN, OPERATOR, serve_backend
from rcp_mavlink_sim import Twin
from rcp_mavlink_sim.modes import Mode

KIND = next(iter(rcp_mavlink.rcp_backends()))
LAT, LON = -35.3632621, 149.1652374


class Pilot:
    """An operator at a gateway with one vehicle behind it."""

    def __init__(self, served: Any, twin: Twin) -> None:
        self.served, self.twin, self.vehicle = served, twin, twin.vehicle
        self.client = served.client(OPERATOR)

    async def do(self, name: str, body: Any = None, **more: Any) -> Any:
        path = f"/tenant/t/{name}"
        return await self.client.request("execute", path, body=body, within=60.0, **more)

    async def read(self, name: str) -> Any:
        reply = await self.client.request("read", f"/tenant/t/{name}")
        assert reply["status"] == "completed", reply
        return reply["body"]

    async def ready(self) -> None:
        await agrees(self.served.life.backend, self.vehicle)


@asynccontextmanager
async def flying(options: dict[str, Any] | None = None, **config: Any) -> AsyncGenerator[Pilot]:
    async with twin(**(options or {})) as running:
        link = f"udpout:127.0.0.1:{running.ports[0][1]}"
        table = {"links": [link], "silence": 1.5, "feedback_timeout": 5.0, **config}
        async with serve_backend(KIND, table) as served:
            await eventually(lambda: _is(bool(served.lives)), "it is heard")
            yield Pilot(served, running)


@pytest.fixture
async def pilot() -> AsyncIterator[Pilot]:
    async with flying() as found:
        await found.ready()
        yield found


async def test_a_refusal_to_arm_carries_its_reason_which_could_be_read_before() -> None:
    async with flying({"warmup": 10_000.0}) as pilot:
        reply = await pilot.do("action/arm")
        assert reply["error"]["code"] == "device_rejected"
        assert reply["error"]["details"] == {
            "result": "failed",
            "texts": ["Arm: Gyros inconsistent"],
        }
        assert reply["message"] == "arm: failed: Arm: Gyros inconsistent"
        told = await pilot.read("sensor/prearm")
        assert (told["ready"], told["mode"]) == (False, "GUIDED")
        assert "Gyros inconsistent" in told["reasons"]


async def test_a_mode_in_which_it_cannot_be_armed_is_named_with_one_in_which_it_can() -> None:
    async with flying() as pilot:
        on_the_ground(pilot.vehicle, Mode.RTL)
        await pilot.ready()
        reply = await pilot.do("action/arm")
        assert "RTL mode not armable" in reply["message"]
        assert reply["error"]["remedy"] == "Set mode GUIDED with action/set_mode first."


async def test_out_and_back_with_progress(pilot: Pilot) -> None:
    client, vehicle = pilot.client, pilot.vehicle
    assert (await pilot.do("action/arm"))["body"] == {"armed": True, "mode": "GUIDED"}
    risen = await pilot.do("action/takeoff", {"altitude": 10})
    assert risen["body"]["altitude"] > 9.6
    id_ = await client.send(
        type="execute", path="/tenant/t/action/move_to", body={"north": 120.0, "altitude": 20.0}
    )
    parts = []
    while True:
        reply = await client.reply(id_, 30.0)
        if reply["status"] != "in_progress":
            if reply["status"] == "accepted":
                continue
            break
        parts.append(reply["progress"])
    assert reply["status"] == "completed", reply
    assert parts == sorted(parts)
    assert len(parts) >= 4
    assert reply["body"]["error"] <= 1.0
    assert abs(vehicle.body.n - 120) < 2
    assert (await pilot.do("action/rtl"))["status"] == "completed"
    assert not vehicle.armed
    assert vehicle.body.landed
    assert abs(vehicle.body.n) < 2


async def test_a_mission_goes_up_is_read_back_and_is_flown(pilot: Pilot) -> None:
    items = [
        {"command": "NAV_TAKEOFF", "altitude": 10.0},
        {"command": "NAV_WAYPOINT", "latitude": LAT + 2e-4, "longitude": LON, "altitude": 12.0},
        {"command": "NAV_RETURN_TO_LAUNCH", "frame": "mission"},
    ]
    assert (await pilot.do("action/mission/upload", {"items": items}))["body"] == {"count": 3}
    back = (await pilot.do("service/mission/download"))["body"]["items"]
    assert [item["command"] for item in back] == [item["command"] for item in items]
    assert back[1]["latitude"] == pytest.approx(LAT + 2e-4, abs=1e-7)
    await pilot.do("action/arm")
    flown = await pilot.do("action/mission/run")
    assert flown["status"] == "completed", flown
    assert flown["body"]["total"] == 3
    assert pilot.vehicle.body.landed


async def test_a_cancel_in_flight_makes_it_hold(pilot: Pilot) -> None:
    airborne(pilot.vehicle)
    await pilot.ready()
    path = "/tenant/t/action/move_to"
    id_ = await pilot.client.send(type="execute", path=path, body={"north": 900.0})
    await eventually(lambda: _is(speed(pilot.vehicle) > 3), "it moves")
    await pilot.client.request("cancel", path)
    assert (await pilot.client.final(id_))["status"] == "cancelled"
    await eventually(lambda: _is(speed(pilot.vehicle) < 0.3), "it holds")
    assert pilot.vehicle.flight.mode is Mode.BRAKE
    assert not pilot.vehicle.body.landed


async def test_whoever_takes_it_away_ends_the_command_with_the_reason(pilot: Pilot) -> None:
    airborne(pilot.vehicle)
    await pilot.ready()
    path = "/tenant/t/action/move_to"
    id_ = await pilot.client.send(type="execute", path=path, body={"north": 900.0})
    await eventually(lambda: _is(speed(pilot.vehicle) > 3), "it moves")
    pilot.vehicle.failsafes.act("Battery", return_home=True)
    final = await pilot.client.final(id_)
    assert final["error"]["code"] == "device_rejected"
    assert final["error"]["details"]["mode"] == "RTL"
    assert "Battery Failsafe" in final["message"]


@pytest.mark.parametrize(
    ("policy", "mode"), [("hold", Mode.BRAKE), ("land", Mode.LAND), ("disarm", None)]
)
async def test_an_estop_does_what_is_configured(policy: str, mode: Mode | None) -> None:
    async with flying(estop=policy) as pilot:
        airborne(pilot.vehicle, 15.0)
        await pilot.ready()
        pilot.vehicle.flight.aim((500.0, 0.0), -15.0)
        await eventually(lambda: _is(speed(pilot.vehicle) > 3), "it moves")
        stop = await pilot.client.request("execute", "/system/estop", deadline=20.0, within=60.0)
        assert stop["status"] == "completed", stop
        # A landing is over when it stands there disarmed: it was called done in the air once.
        done = speed(pilot.vehicle) < 0.5 if policy == "hold" else not pilot.vehicle.armed
        assert done
        assert mode is None or pilot.vehicle.flight.mode is mode
        assert pilot.vehicle.body.landed is (policy != "hold") or policy == "disarm"
        refused = await pilot.do("action/move_to", {"north": 1.0})
        assert refused["error"]["code"] == "estop_active"
        reset = await pilot.served.client(ADMIN).request(
            "execute", "/system/estop", body={"reset": True}
        )
        assert reset["status"] == "completed"


async def test_a_link_that_is_cut_in_flight_is_told_and_comes_back_by_itself(pilot: Pilot) -> None:
    airborne(pilot.vehicle)
    await pilot.ready()
    path = "/tenant/t/action/move_to"
    id_ = await pilot.client.send(type="execute", path=path, body={"north": 900.0})
    await eventually(lambda: _is(speed(pilot.vehicle) > 3), "it moves")
    pilot.twin.muted = True
    final = await pilot.client.final(id_)
    assert final["error"]["code"] == "adapter_unavailable"
    assert "no message from vehicle 1" in final["message"]
    pilot.twin.muted = False
    supervisor = pilot.served.supervisor
    await eventually(lambda: _is(supervisor.state == "ready"), "it is back")
    assert (await pilot.read("sensor/mode")) in ("GUIDED", "BRAKE")


async def test_after_a_reboot_it_is_asked_for_everything_again(pilot: Pilot) -> None:
    on_the_ground(pilot.vehicle)
    await pilot.ready()
    id_ = await pilot.client.subscribe("/tenant/t/sensor/attitude", rate=20)
    await pilot.client.update(id_)
    assert (await pilot.do("service/reboot"))["status"] == "completed"
    for _ in range(5):
        await pilot.client.update(id_)


async def test_an_unknown_parameter_is_told_fast_with_near_names(pilot: Pilot) -> None:
    backend = pilot.served.life.backend
    async with asyncio.timeout(60):
        await backend.robots[""].parameters.complete.wait()
    reply = await pilot.do("service/param/read", {"name": "WPNAV_SPED"})
    assert reply["error"]["code"] == "unknown_path"
    assert "WPNAV_SPEED" in reply["error"]["remedy"]
    written = await pilot.client.request("write", "/tenant/t/param/RTL_ALT", body=2000)
    assert written["body"] == 2000
    assert pilot.vehicle.params["RTL_ALT"] == 2000
    path = "/tenant/t/param/GUID_TIMEOUT"
    for huge in (3.5e38, -1e300):
        refused = await pilot.client.request("write", path, body=huge)
        assert refused["error"]["code"] == "out_of_range"


async def test_a_rate_is_pushed_down_and_taken_back(pilot: Pilot) -> None:
    (peer,) = pilot.twin.peers
    assert peer.streams.interval(30) == -1
    id_ = await pilot.client.subscribe("/tenant/t/sensor/attitude", rate=20)
    await eventually(lambda: _is(peer.streams.interval(30) == 50_000), "asked for")
    await pilot.client.request("unsubscribe", body={"subscription": id_})
    await eventually(lambda: _is(peer.streams.interval(30) == -1), "taken back")


async def test_a_velocity_is_flown_until_its_client_is_gone(pilot: Pilot) -> None:
    airborne(pilot.vehicle)
    await pilot.ready()
    path = "/tenant/t/actuator/velocity"
    for _ in range(4):
        reply = await pilot.client.request("write", path, body={"y": 3.0}, valid_for=0.4)
        assert reply["status"] == "completed", reply
    await eventually(lambda: _is(pilot.vehicle.body.ve < -2), "it moves to its left")
    await eventually(lambda: _is(speed(pilot.vehicle) < 0.3), "the dead-man stops it")


async def test_a_set_point_out_of_its_mode_is_refused(pilot: Pilot) -> None:
    on_the_ground(pilot.vehicle)
    await pilot.ready()
    reply = await pilot.client.request("write", "/tenant/t/actuator/velocity", body={"x": 1.0})
    assert reply["error"]["code"] == "mode_forbids"


async def test_a_fence_goes_up_and_comes_back(pilot: Pilot) -> None:
    corners = [(-1, -1), (-1, 1), (1, 1), (1, -1)]
    items = [
        {
            "command": "NAV_FENCE_POLYGON_VERTEX_INCLUSION",
            "params": [4.0],
            "latitude": LAT + a * 2e-4,
            "longitude": LON + b * 2e-4,
        }
        for a, b in corners
    ]
    assert (await pilot.do("service/fence/upload", {"items": items}))["body"] == {"count": 4}
    back = (await pilot.do("service/fence/download"))["body"]["items"]
    assert [item["latitude"] for item in back] == pytest.approx([i["latitude"] for i in items])
    assert len(pilot.vehicle.fence.plan.items) == 4


async def test_a_log_is_listed_and_read_in_ranges(pilot: Pilot) -> None:
    airborne(pilot.vehicle)
    on_the_ground(pilot.vehicle)
    await pilot.ready()
    truth = bytes(pilot.vehicle.log.logs[1])
    (log,) = (await pilot.do("service/log/list"))["body"]
    assert (log["id"], log["size"]) == (1, len(truth))
    half = len(truth) // 2
    parts = [
        await pilot.do("service/log/read", {"id": 1, "offset": at, "count": half + 1})
        for at in (0, half + 1)
    ]
    assert b"".join(base64.b64decode(part["body"]["data"]) for part in parts) == truth
    gone = await pilot.do("service/log/read", {"id": 99})
    assert gone["error"]["code"] == "invalid_value"


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
