"""Integers beyond those that JSON numbers carry exactly reach a Go and a Rust program, and the robot, unchanged."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from clients.test_go import EXAMPLE, go
from clients.test_rust import passes, rustc
from configuration import backend, listener, table
from rcp_client import connect
from rcp_client.codegen import generate
from rcp_gateway.log import configure
from rcp_gateway.testing import ScriptedRobot, scripted, serve
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.types import Int64, UInt64

pytestmark = pytest.mark.anyio
HERE = Path(__file__).parent
CONFIG = listener() + backend() + table("anonymous", role="operator")


class Parcel(msgspec.Struct, frozen=True, kw_only=True):
    """Integers of each type."""

    i64: Int64
    u64: UInt64
    small: int
    any: Any


LOW, HIGH, ODD = -(2**63), 2**64 - 1, 2**53 + 1
SENT = Parcel(i64=LOW, u64=HIGH, small=5, any={"n": [ODD, 5, 5.0, "5"]})
WRITTEN = Parcel(i64=2**63 - 1, u64=2**63, small=-5, any={"n": [ODD, 5, 5.0, "5"]})


@pytest.fixture
async def robot() -> AsyncGenerator[tuple[ScriptedRobot, str]]:
    robots: list[ScriptedRobot] = []

    def make(host: Any) -> ScriptedRobot:
        resource = Resource(name="param/parcel", description="A parcel.", value=Parcel)
        robots.append(ScriptedRobot(host, resource, values={"param/parcel": SENT}))
        return robots[-1]

    configure("error", "json")
    async with serve(parse(CONFIG, "test"), scripted(make)) as served:
        url = next(facts["url"] for facts in served.server.status.transports if "url" in facts)
        yield robots[0], url


async def generated(language: str, url: str) -> str:
    async with connect(url) as client:
        return generate(language, await client.discover("/tenant/**"), url)


async def test_a_go_program_reads_watches_and_writes_them(
    robot: tuple[ScriptedRobot, str], tmp_path: Path
) -> None:
    made, url = robot
    shutil.copy(EXAMPLE / "go.mod", tmp_path)
    shutil.copy(HERE / "wide_test.go", tmp_path)
    (tmp_path / "rcp.go").write_text(await generated("go", url), encoding="utf-8")
    await asyncio.to_thread(go, tmp_path, "test", "-count=1", ".", RCP_URL=url)
    assert made.writes == [("param/parcel", WRITTEN)]
    assert [type(item) for item in made.writes[0][1].any["n"]] == [int, int, float, str]


async def test_a_rust_program_reads_watches_and_writes_them(
    robot: tuple[ScriptedRobot, str], tmp_path: Path
) -> None:
    made, url = robot
    shutil.copy(HERE / "wide_test.rs", tmp_path)
    (tmp_path / "rcp.rs").write_text(await generated("rust", url), encoding="utf-8")
    await asyncio.to_thread(rustc, tmp_path / "wide_test.rs", "--test")
    await asyncio.to_thread(passes, tmp_path / "wide_test", RCP_URL=url)
    assert made.writes == [("param/parcel", WRITTEN)]
    assert [type(item) for item in made.writes[0][1].any["n"]] == [int, int, float, str]
