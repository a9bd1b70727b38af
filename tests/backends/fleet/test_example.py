"""`examples/fleet` does what it says: a hub and three robots, each in a process of its own."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from ports import free_port
from rcp_client import Client, connect
from rcp_client.errors import RcpError
from rcp_gateway.testing import eventually

RUN = Path(__file__).parents[3] / "examples" / "fleet" / "run.py"
_STARTS = 120.0  # s: four gateways, of which one has a simulated vehicle


@pytest.fixture
def fleet() -> Iterator[tuple[str, str]]:
    """Run it; its address and the operator's key."""
    port, router = free_port(), free_port()
    command = [sys.executable, str(RUN), "--port", str(port), "--router", str(router)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        token = None
        while token is None:
            line = process.stdout.readline()
            assert line, "it ended before it told its key"
            found = re.search(r"RCP_TOKEN=(\S+)", line)
            token = found and found[1]
        try:
            yield f"http://127.0.0.1:{port}", token
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 0


@pytest.mark.paired
async def test_a_person_uses_the_robots_of_a_fleet_and_stops_them(fleet: tuple[str, str]) -> None:
    url, token = fleet

    async def serves() -> bool:
        try:
            async with connect(url, token=token) as client:
                robots = await client.read("/system/robots")
        except RcpError:
            return False
        return [one["path"].rpartition("/")[2] for one in robots] == ["d1", "r1", "r2"] and all(
            one["state"] == "ready" for one in robots
        )

    await eventually(serves, "all robots are ready", _STARTS)
    async with connect(url, token=token) as client:
        await _drive(client)


async def _drive(client: Client) -> None:
    goal = {"position": {"x": 0.5, "y": 0.2, "z": 0.0}}
    done: Any = await client.execute("/action/r1/move_to", goal)
    assert done["error"] < 0.3, done
    stopped: Any = await client.estop()
    assert {one["state"] for one in stopped["robots"].values()} == {"confirmed"}
    assert len(stopped["robots"]) == 3
