"""One script patrols with every mobile robot, and the robot is where the script says."""

from __future__ import annotations

import asyncio
import math
import re
import signal
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from patrol.machines import ADMIN, KEY, MACHINES, Machine, Truth
from rcp_gateway.testing import eventually

SCRIPT = Path(__file__).parents[2] / "examples" / "patrol.py"
CORNER = re.compile(r"\d+/\d+: to x (-?[\d.]+) m, y (-?[\d.]+) m in \w+")
_WITHIN = 120.0  # s for any robot on any machine

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    """Run on asyncio: the kernel's event loop."""
    return "asyncio"


class Run:
    """The script as a process, and its lines so far."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.lines: list[str] = []

    async def until(self, words: str) -> None:
        """Read until a line has these words."""
        assert self.process.stdout is not None
        async with asyncio.timeout(_WITHIN):
            while line := (await self.process.stdout.readline()).decode().rstrip():
                self.lines.append(line)
                if words in line:
                    return
        raise AssertionError(f"no {words!r} in {self.lines}")

    async def end(self) -> int:
        """Wait for its end; return its exit status."""
        async with asyncio.timeout(_WITHIN):
            out, _ = await self.process.communicate()
        self.lines += out.decode().splitlines()
        assert self.process.returncode is not None
        return self.process.returncode


@asynccontextmanager
async def patrol(machine: Machine, *more: str) -> AsyncGenerator[Run]:
    """Run the script for a robot; the arguments are the same for each but for the robot's size."""
    arguments = ["/tenant/t", "--url", machine.url, "--token", KEY, "--side", str(machine.side)]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-u", SCRIPT, *arguments, *more,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT,
    )  # fmt: skip
    try:
        yield Run(process)
    finally:
        if process.returncode is None:
            process.kill()
            await process.communicate()


@asynccontextmanager
async def observed(machine: Machine) -> AsyncGenerator[list[Truth]]:
    """Note where the robot is while entered."""
    track: list[Truth] = []

    async def watch() -> None:
        while True:
            track.append(machine.truth())
            await asyncio.sleep(0.02)

    task = asyncio.create_task(watch())
    try:
        yield track
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def rests(machine: Machine) -> None:
    """Wait until the device is at rest."""

    async def still() -> bool:
        return machine.truth().still

    await eventually(still, "it is at rest", 30.0)


@pytest.mark.parametrize("name", MACHINES)
async def test_it_goes_around_a_square_and_back(name: str) -> None:
    async with MACHINES[name]() as machine:
        start = machine.truth()
        async with observed(machine) as track, patrol(machine) as run:
            assert await run.end() == 0, run.lines
        assert any("m left" in line for line in run.lines)
        text = "\n".join(run.lines)
        corners = [(float(x), float(y)) for x, y in CORNER.findall(text)]
        side, near = machine.side, machine.near
        square = [(side, 0.0), (side, side), (0.0, side), (0.0, 0.0)]
        assert len(corners) == 4, run.lines
        for (x, y), (dx, dy) in zip(corners, square, strict=True):
            assert math.dist((x, y), (start.x + dx, start.y + dy)) < near
            assert min(math.dist((x, y), at[:2]) for at in track) < near
        assert math.dist(machine.truth()[:2], start[:2]) < 2 * near
        await rests(machine)


@pytest.mark.parametrize("name", MACHINES)
async def test_an_interrupt_on_the_way_brings_it_to_rest(name: str) -> None:
    async with MACHINES[name]() as machine, patrol(machine, "--rounds", "9") as run:
        await run.until("m left")
        run.process.send_signal(signal.SIGINT)
        assert await run.end() == 130, run.lines
        assert "at rest" in run.lines, run.lines
        if name != "copter":  # it hovers
            assert machine.truth().still
        running = await commands(machine)
        assert not running, running


async def commands(machine: Machine) -> list[Any]:
    """List the commands that have not ended."""
    reply = await machine.served.client(KEY).request("read", "/system/commands")
    ends = ("completed", "cancelled", "failed", "rejected")
    return [one for one in reply["body"] if one["status"] not in ends]


async def test_a_second_patrol_of_a_robot_is_refused_with_the_reason() -> None:
    async with MACHINES["simulated rover"]() as machine, patrol(machine, "--rounds", "9") as one:
        await one.until("m left")
        async with patrol(machine) as two:
            assert await two.end() == 1
        assert two.lines[-1].startswith("rejected, already_running: "), two.lines
        assert "in progress" in two.lines[-1]
        async with patrol(machine, "--stop") as stop:
            assert await stop.end() == 0
        assert stop.lines == ["at rest"]
        assert await one.end() == 1
        await rests(machine)


@pytest.mark.parametrize("name", ["simulated rover", "CAN wheels"])
async def test_an_e_stop_on_the_way_ends_it_at_rest(name: str) -> None:
    async with MACHINES[name]() as machine, patrol(machine, "--rounds", "9") as run:
        await run.until("m left")
        admin = machine.served.client(ADMIN)
        reply = await admin.request("execute", "/system/estop", body={"scope": "/tenant/t"})
        assert reply["status"] == "completed", reply
        assert machine.truth().still
        assert await run.end() == 1
        async with patrol(machine) as again:
            assert await again.end() == 1
        assert "estop_active" in again.lines[-1]


@pytest.mark.parametrize("name", ["ArduPilot rover", "CAN wheels"])
async def test_a_link_cut_on_the_way_is_told_as_a_failure(name: str) -> None:
    async with MACHINES[name]() as machine, patrol(machine, "--rounds", "9") as run:
        await run.until("m left")
        assert machine.cut is not None
        machine.cut()
        assert await run.end() == 1
        assert run.lines[-1].startswith("failed, "), run.lines
