"""A link can simulate its vehicle, in a process that ends with the gateway whatever ends that."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import rcp_mavlink
from rcp_gateway.testing import Client, eventually
from rcp_gateway.testing._serve import OPERATOR, serve_backend
from rcp_kernel.errors import NotReady
from rcp_mavlink.config import MavlinkConfig
from rcp_mavlink.dialect import dialect
from rcp_mavlink.hub import open_hub

pytestmark = pytest.mark.real_time

KIND = next(iter(rcp_mavlink.rcp_backends()))
QUICK = {"warmup": 0.0, "speed": 10.0}
PATIENT: dict[str, Any] = {"silence": 30.0, "connect": 60.0, "feedback_timeout": 10.0}
"""A vehicle has a process of its own here, which a busy machine may not run for seconds."""
_GATEWAY = """
import asyncio
from rcp_mavlink.config import MavlinkConfig, TwinConfig
from rcp_mavlink.dialect import dialect
from rcp_mavlink.hub import open_hub

async def main():
    async with open_hub(MavlinkConfig(links=("sim:copter",)), dialect("ardupilotmega")) as hub:
        await hub.first()
        print("heard", flush=True)
        await asyncio.Event().wait()

asyncio.run(main())
"""


def children(parent: int) -> list[int]:
    path = Path(f"/proc/{parent}/task/{parent}/children")
    return [int(word) for word in path.read_text().split()]


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return "Z" not in Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]


async def one_is_stopped(client: Client) -> None:
    """Stop the vehicle on the ground: the one in the air is held by no latch."""
    scope = "/tenant/t/vehicle1"
    reply = await client.request("execute", "/system/estop", body={"scope": scope})
    (latched,) = reply["body"]["robots"]
    assert latched.endswith("/vehicle1")
    refused = await client.request("execute", "/tenant/t/action/vehicle1/arm")
    assert refused["error"]["code"] == "estop_active"


async def test_two_simulated_vehicles_are_robots_and_one_is_flown() -> None:
    waits = {"parameters": {"DISARM_DELAY": 0.0}}  # at ten times the speed a second is soon over
    links = ["sim:copter", "sim:copter"]
    table = {"links": links, "discover": True, "params": [], "twin": QUICK | waits, **PATIENT}
    async with serve_backend(KIND, table) as served:
        client = served.client(OPERATOR)

        async def both() -> bool:
            replies = [
                await client.request("read", f"/tenant/t/sensor/vehicle{n}/mode") for n in (1, 2)
            ]
            return [r["status"] for r in replies] == ["completed"] * 2

        await eventually(both, "both are heard")
        for action in ("arm", "takeoff", "land"):
            reply = await client.request("execute", f"/tenant/t/action/vehicle2/{action}")
            assert reply["status"] == "completed", reply
            if action == "takeoff":
                await one_is_stopped(client)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_gateway_that_is_killed_leaves_no_vehicle_behind() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", _GATEWAY], stdout=subprocess.PIPE, text=True
    ) as gateway:
        assert gateway.stdout is not None
        assert gateway.stdout.readline() == "heard\n"
        (vehicle,) = children(gateway.pid)
        gateway.send_signal(signal.SIGKILL)

    async def gone() -> bool:
        return not alive(vehicle)

    asyncio.run(eventually(gone, "the vehicle ended"))


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
async def test_a_vehicle_that_fails_is_started_anew() -> None:
    config = MavlinkConfig(links=("sim:copter",), silence=1.0)
    before = set(children(os.getpid()))
    async with open_hub(config, dialect("ardupilotmega")) as hub:
        await hub.first()
        (first,) = set(children(os.getpid())) - before
        os.kill(first, signal.SIGKILL)
        vehicle = hub.vehicles[1]
        await eventually(lambda: _is(vehicle.lost), "it is lost")
        await eventually(lambda: _is(not vehicle.lost), "another one is heard")
    assert set(children(os.getpid())) <= before


async def _is(value: Any) -> bool:
    return bool(value)


async def test_a_vehicle_that_cannot_start_says_why() -> None:
    config = MavlinkConfig(
        links=("sim:copter",), connect=60.0, twin=rcp_mavlink.TwinConfig(parameters={"NONE": 1.0})
    )
    async with open_hub(config, dialect("ardupilotmega")) as hub:
        await eventually(lambda: _is(hub.links[0].error), "it is told")
        assert "it has no parameter NONE" in str(hub.links[0].error)


async def test_a_signed_link_has_a_vehicle_that_signs() -> None:
    config = MavlinkConfig(links=("sim:copter",), connect=60.0, key="secret")
    async with open_hub(config, dialect("ardupilotmega")) as hub:
        try:
            await hub.first()
        except NotReady as error:
            pytest.fail(str(error))
        assert not hub.links[0].framer.stats.rejected


@pytest.mark.parametrize("kind", ["rover", "boat"])
async def test_what_drives_goes_to_a_place_follows_a_velocity_and_comes_home(kind: str) -> None:
    async with serve_backend(KIND, _table(kind)) as served:
        client = served.client(OPERATOR)

        async def does(verb: str, name: str, body: Any = None) -> Any:
            reply = await client.request(verb, f"/tenant/t/{name}", body=body, within=60.0)
            assert reply["status"] == "completed", reply
            return reply["body"]

        await _ready(client)
        await does("execute", "action/arm")
        reached = await does("execute", "action/move_to", {"north": 12.0, "east": 4.0})
        assert reached["error"] < 2
        await does("write", "actuator/velocity", {"x": 1.0, "yaw_rate": 0.0})

        async def moves() -> bool:
            return (await does("read", "sensor/velocity"))["groundspeed"] > 0.5

        await eventually(moves, "it moves")
        await does("execute", "action/rtl")
        await does("execute", "action/disarm")


async def test_a_plane_takes_off_circles_a_place_and_keeps_files() -> None:
    async with serve_backend(KIND, _table("plane")) as served:
        client = served.client(OPERATOR)

        async def does(name: str, body: Any = None) -> Any:
            path = f"/tenant/t/{name}"
            reply = await client.request("execute", path, body=body, within=60.0)
            assert reply["status"] == "completed", reply
            return reply["body"]

        await _ready(client)
        await does("action/arm")
        await does("action/takeoff", {"altitude": 40.0})
        reached = await does("action/move_to", {"north": 300.0, "east": 0.0, "altitude": 60.0})
        assert reached["altitude"] > 50
        await does("service/ftp/write", {"path": "/APM/a.txt", "data": "aGVsbG8="})
        assert (await does("service/ftp/read", {"path": "/APM/a.txt"}))["data"] == "aGVsbG8="
        await does("action/rtl")


def _table(kind: str) -> dict[str, Any]:
    return {"links": [f"sim:{kind}"], "params": [], "twin": QUICK, **PATIENT}


async def _ready(client: Any) -> None:
    async def ready() -> bool:
        reply = await client.request("read", "/tenant/t/sensor/prearm")
        return reply["status"] == "completed" and reply["body"]["ready"]

    await eventually(ready, "it can be armed", 20.0)
