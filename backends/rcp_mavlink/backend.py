"""The backend: each call goes to the vehicle that its name belongs to."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.spi import BaseBackend, Host, Progress
from rcp_mavlink.config import MavlinkConfig
from rcp_mavlink.described import checked
from rcp_mavlink.dialect import dialect
from rcp_mavlink.hub import Hub, open_hub
from rcp_mavlink.robot import Robot
from rcp_mavlink.vehicle import Vehicle

__all__ = ["MavlinkBackend", "open_mavlink"]

_LOOK = 1.0  # s


class MavlinkBackend(BaseBackend):
    """The vehicles behind the links of one backend."""

    def __init__(self, hub: Hub, host: Host) -> None:
        self.hub, self._host = hub, host
        self.robots: dict[str, Robot] = {}
        """By the segment that their paths have; the empty one stands for a single vehicle."""

    def found(self, vehicle: Vehicle) -> None:
        """Put a vehicle in the tree that is heard for the first time."""
        prefix = ""
        if self.hub.config.discover:
            prefix = self.hub.config.names.get(str(vehicle.system), f"vehicle{vehicle.system}")
        robot = self.robots[prefix] = Robot(self.hub, vehicle, self._host, prefix)
        robot.begin()

    def changed(self, vehicle: Vehicle) -> None:
        """Say who is lost and who is back."""
        for robot in self.robots.values():
            if robot.vehicle is vehicle and not vehicle.lost:
                robot.back()
        lost = [v for v in self.hub.vehicles.values() if v.lost]
        if not lost:
            self._host.report(None)
            return
        detail = "; ".join(self.hub.silent(v) for v in lost)
        self._host.report(detail, down=len(lost) == len(self.hub.vehicles))

    async def look(self) -> None:
        """Look after the vehicles, until cancelled."""
        while True:
            await asyncio.sleep(_LOOK)
            for robot in self.robots.values():
                robot.look()

    def _robot(self, name: str) -> tuple[Robot, str]:
        if not self.hub.config.discover:
            robot = self.robots.get("")
            if robot is not None:
                return robot, name
        else:
            branch, prefix, rest = [*name.split("/", 2), "", ""][:3]
            if prefix in self.robots:
                return self.robots[prefix], f"{branch}/{rest}"
        raise AdapterUnavailable(f"no vehicle for '{name}' is heard")

    async def read(self, name: str) -> Any:
        """Return the present value."""
        robot, own = self._robot(name)
        return await robot.read(own)

    async def write(self, name: str, value: Any) -> Any:
        """Write a parameter or a set-point."""
        robot, own = self._robot(name)
        return await robot.write(own, value)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or service to its end, as telemetry shows it."""
        robot, own = self._robot(name)
        return await robot.execute(own, value, progress)

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[object]:
        """Have the vehicle send it while entered."""
        robot, own = self._robot(name)
        return robot.watch(own, rate)

    async def halt(self) -> None:
        """Bring every vehicle to rest, by the configured policy."""
        there = [robot for robot in self.robots.values() if not robot.vehicle.lost]
        await asyncio.gather(*(robot.halt() for robot in there))

    async def halt_robot(self, robot: str) -> None:
        """Bring one vehicle to rest, by the configured policy."""
        there = self.robots.get(robot)
        if there is not None and not there.vehicle.lost:
            await there.halt()


@asynccontextmanager
async def open_mavlink(config: MavlinkConfig, host: Host) -> AsyncGenerator[MavlinkBackend]:
    """Open the links and wait for the first vehicle; leaving takes back what was asked for.

    :raises ConfigError: the dialect, or what describes the parameters, cannot be had.
    :raises NotReady: a link cannot be opened, or no vehicle is heard.
    """
    messages = await asyncio.to_thread(dialect, config.dialect)
    await asyncio.to_thread(checked, config.parameters)
    async with open_hub(config, messages) as hub:
        backend = MavlinkBackend(hub, host)
        hub.found, hub.changed = backend.found, backend.changed
        await hub.first()
        await asyncio.sleep(0)
        looking = asyncio.create_task(backend.look())
        try:
            yield backend
        finally:
            hub.found = hub.changed = lambda _: None
            looking.cancel()
            await asyncio.gather(looking, return_exceptions=True)
            for robot in backend.robots.values():
                await robot.close()
