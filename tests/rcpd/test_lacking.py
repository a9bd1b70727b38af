"""What a machine lacks, a library or a file, keeps only the part that needs it from being served."""

from __future__ import annotations

import asyncio
import shutil
import sys
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from rcp_gateway.reload import apply, prepare_reload
from rcp_gateway.server import prepare, running
from rcp_gateway.testing import ADMIN, BOUND, Served
from rcp_kernel.config.file import GatewayConfig, parse
from rcp_mujoco.robots import MODELS
from rcpd.diagnosis import Diagnosis

pytestmark = pytest.mark.anyio
SIM = f"""keys = [{{ name = "admin", role = "admin", key = "{ADMIN}" }}]
safety = {{ guard = false }}
transports = {{ asgi = false, http = false, ws = false, sse = false }}
[[backends]]
name = "rovers"
use = "sim"
tenant = "a"
"""
DRONECAN = """[[backends]]
name = "late"
robot = "late"
use = "can"
tenant = "a"
[backends.buses.can0]
interface = "virtual"
simulate = true
[backends.motors.pan]
bus = "can0"
profile = "dronecan"
node = 1
velocity = 3.0
options = { index = 0 }
"""
MUJOCO = '[[backends]]\nname = "late"\nrobot = "late"\nuse = "mujoco"\ntenant = "a"\nmodel = "{folder}/arm.xml"\n'
MAVLINK = """[[backends]]
name = "late"
robot = "late"
use = "mavlink"
tenant = "a"
links = ["sim:copter"]
dialect = "{folder}/ours.xml"
"""
GRPC = "[plugins.a2a]\n[plugins.a2a.grpc]\nport = 0\n"
LATE = {
    "library": (DRONECAN, "dronecan", "No module named 'dronecan'"),
    "model": (MUJOCO, "", "there is no file"),
    "dialect": (MAVLINK, "", "there is no file"),
}


def without(module: str, patch: pytest.MonkeyPatch) -> None:
    if module:
        patch.setitem(sys.modules, module, None)


@asynccontextmanager
async def gateway(config: GatewayConfig) -> AsyncGenerator[Served]:
    async with running(prepare(config, "rcp.toml")) as server:
        yield Served(server, [])


async def assert_serves_and_stops(served: Served) -> None:
    client = served.client(ADMIN)
    read = await client.request("read", "/tenant/a/sensor/imu")
    assert read["status"] == "completed", read
    stopped = await client.request("execute", "/system/estop", body={})
    assert stopped["body"]["robots"]["rovers"]["state"] == "confirmed", stopped


async def status_of(served: Served) -> dict[str, Any]:
    return (await served.client(ADMIN).request("read", "/system/status"))["body"]


def named(parts: list[dict[str, Any]], name: str) -> dict[str, Any]:
    return next(one for one in parts if one["name"] == name)


@pytest.mark.parametrize("what", LATE)
async def test_the_other_robots_are_served_and_stopped(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text, module, reason = LATE[what]
    text = SIM + text.replace("{folder}", str(tmp_path))
    without(module, monkeypatch)
    assert any(reason in one.message for one in Diagnosis(text, "rcp.toml").findings)
    async with gateway(parse(text, "rcp.toml")) as served:
        late = named((await status_of(served))["backends"], "late")
        assert late["state"] == "down"
        assert reason in late["detail"]
        await assert_serves_and_stops(served)


@pytest.mark.parametrize("what", LATE)
async def test_a_reload_is_applied(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text, module, reason = LATE[what]
    without(module, monkeypatch)
    before = parse(SIM, "rcp.toml")
    after = parse(SIM + text.replace("{folder}", str(tmp_path)), "rcp.toml")
    async with gateway(before) as served:
        await apply(served.server, prepare_reload(before, after, "rcp.toml"))
        late = next(one for one in served.server.supervisors if one.name == "late")
        async with asyncio.timeout(BOUND):
            await late.settled.wait()
        assert late.state == "down"
        assert reason in (late.detail or "")
        await assert_serves_and_stops(served)


def put_model(folder: Path) -> None:
    shutil.copy(MODELS / "arm.xml", folder / "arm.xml")


def put_dialect(folder: Path) -> None:
    (folder / "ours.xml").write_text("""<?xml version="1.0"?>
<mavlink><include>common.xml</include><enums/><messages/></mavlink>
""")


@pytest.mark.parametrize(
    ("text", "put"), [(MUJOCO, put_model), (MAVLINK, put_dialect)], ids=["model", "dialect"]
)
async def test_the_backend_opens_when_the_file_appears(
    text: str, put: Callable[[Path], None], tmp_path: Path
) -> None:
    config = parse(SIM + text.replace("{folder}", str(tmp_path)), "rcp.toml")
    async with gateway(config) as served:
        late = next(one for one in served.server.supervisors if one.name == "late")
        assert late.state == "down"
        ready = asyncio.Event()
        served.server.gateway.registry.on_state.append(
            lambda: ready.set() if late.state == "ready" else None
        )
        put(tmp_path)
        async with asyncio.timeout(BOUND):
            await ready.wait()


async def test_the_robots_are_served_without_grpc(monkeypatch: pytest.MonkeyPatch) -> None:
    without("grpc", monkeypatch)
    text = SIM + GRPC
    assert any("'grpc'" in one.message for one in Diagnosis(text, "rcp.toml").findings)
    async with gateway(parse(text, "rcp.toml")) as served:
        agent = named((await status_of(served))["adapters"], "a2a")
        assert agent["state"] == "down"
        assert "rcp-gateway[grpc]" in agent["detail"]
        await assert_serves_and_stops(served)
