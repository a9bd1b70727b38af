"""A rover behind its own gateway and a hub is what its profiles say, and patrols as any robot."""

from __future__ import annotations

import math
import sys
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import anyio
import pytest

pytest.importorskip("zenoh")

import rcp_sim
from backends.fleet.rig import appears, hub_at, robot_at, serving
from configuration import backend, configuration, listener, table
from ports import free_port
from rcp_fleet import rcp_backends
from rcp_gateway.testing import OPERATOR, Body, ProfileSuite, Robot, Served

PATROL = Path(__file__).parents[3] / "examples" / "patrol.py"


class TestRoverThroughAHub(ProfileSuite):
    """What the profiles mean, as a client of a hub has it."""

    kind = next(iter(rcp_backends()))
    profiles = ("mobile", "battery", "camera", "lidar", "power")
    place = "r7"
    port: int

    @asynccontextmanager
    async def twin(self) -> AsyncGenerator[Served]:
        self.port = free_port()
        box = {"x": 0.0, "y": 4.5, "size_x": 8.0, "size_y": 1.0}
        world = {"width": 12.0, "height": 12.0, "obstacles": [box]}
        rover = backend(
            "rover", use="sim", noise=0.0, map_resolution=0.5, time_scale=3.0, world=world
        )
        text = robot_at(self.port, rover).replace('"alpha"', '"t"')
        async with serving(text, *rcp_sim.rcp_backends()) as robot:
            yield robot

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Robot]:
        async with super().served_by_device() as robot:
            await appears(robot.client, "/tenant/t/sensor/r7/pose")
            yield robot

    def table(self) -> Mapping[str, Any]:
        return {"hub": "h1", "listen": [f"tcp/127.0.0.1:{self.port}"], "token": OPERATOR}

    @property
    def _device(self) -> Any:
        return self.device.life.backend.device

    async def body(self) -> Body:
        rover = self._device.sim.rover
        return Body(x=rover.x, y=rover.y, yaw=rover.yaw, forward=rover.v, yaw_rate=rover.w)

    async def at_rest(self) -> bool:
        return self._device.sim.rover.at_rest

    async def charge(self) -> float:
        return self._device.sim.pack.charge

    async def obstacle(self, bearing: float) -> float | None:
        """Measure to the box on its left and to the walls, at right angles from the start."""
        x, y = math.cos(bearing), math.sin(bearing)
        left = 4.0 if y > 0 else 6.0
        return min(6.0 / abs(x) if x else math.inf, left / abs(y) if y else math.inf)


async def test_patrol_drives_it() -> None:
    port = free_port()
    hub = hub_at(port).replace(configuration(), table("transports", sse=False) + listener())
    async with serving(hub) as served, serving(robot_at(port)):
        client = served.client(OPERATOR)
        await appears(client, "/tenant/alpha/sensor/r7/pose")
        await client.close()
        url = next(one["url"] for one in served.server.status.transports if "url" in one)
        where = ["--url", url, "--token", OPERATOR, "--side", "0.5"]
        command = [sys.executable, str(PATROL), "/tenant/alpha/r7", *where]
        with anyio.fail_after(120.0):
            done = await anyio.run_process(command, check=False)
        assert done.returncode == 0, done
        assert done.stdout.count(b"  there") == 4, done
