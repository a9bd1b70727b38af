"""`pip install rcp-client`: a script talks to a robot, and no server is installed for it."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import pytest

from docs.demo import Demo, demo
from installed.fresh import importable, said, venv, wheels
from rcp_client.codegen import generate

pytestmark = pytest.mark.timeout(900)

SERVER = """
    uvicorn litestar httptools uvloop pluggy structlog psutil prometheus_client cryptography jwt
    zstandard cel pymavlink can canopen cantools mcp a2a simplejpeg rclpy numpy pydantic rcp_kernel
"""

SCRIPT = """
import asyncio, rcp_client
from rcp_client import Robot

async def drive():
    async with rcp_client.connect() as robot:
        before = await robot.read("/tenant/alpha/sensor/pose")
        goal = {"position": {"x": 0.5, "y": 0.0, "z": 0.0}}
        await robot.execute("/tenant/alpha/action/move_to", goal, deadline=60)
        async for update in robot.subscribe("/tenant/alpha/sensor/pose", count=2):
            pose = update.body
        return before, pose

before, after = asyncio.run(drive())
assert before != after, (before, after)
with Robot() as robot:
    place = robot.read("/tenant/alpha/sensor/pose")["position"]
    assert abs(place["x"] - 0.5) < 0.2, place
    print("driven")
"""


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("client")
    return venv(folder / "venv", *wheels(folder / "wheels", "clients/python"))


@pytest.fixture(scope="module")
def robots(tmp_path_factory: pytest.TempPathFactory) -> Generator[Demo]:
    with demo(tmp_path_factory.mktemp("demo")) as running:
        yield running


CODEGEN = """
from rcp_client.codegen import generate
for language in ("go", "python", "rust", "typescript"):
    print(len(generate(language, [], "http://robots")))
"""


def test_it_brings_what_generated_clients_consist_of(programs: Path) -> None:
    languages = ("go", "python", "rust", "typescript")
    sizes = [len(generate(language, [], "http://robots")) for language in languages]
    assert [int(size) for size in said(programs, "python", "-c", CODEGEN).split()] == sizes


def test_it_brings_no_server(programs: Path) -> None:
    assert importable(programs, *SERVER.split()) == []
    assert importable(programs, "rcp_client", "rcp_protocol") == ["rcp_client", "rcp_protocol"]


def test_rcpctl_reads_and_moves_a_robot(programs: Path, robots: Demo) -> None:
    at = {"RCP_URL": robots.url, "RCP_TOKEN": robots.key}
    assert "position" in said(programs, "rcpctl", "read", "/tenant/alpha/sensor/pose", **at)
    goal = '{"position": {"x": 0.3, "y": 0.0, "z": 0.0}}'
    output = said(programs, "rcpctl", "execute", "/tenant/beta/action/move_to", goal, **at)
    assert "completed" in output


def test_a_script_reads_moves_and_watches_a_robot(programs: Path, robots: Demo) -> None:
    at = {"RCP_URL": robots.url, "RCP_TOKEN": robots.key}
    assert said(programs, "python", "-c", SCRIPT, **at).strip() == "driven"
