"""The backend: buses that run, and parts that the calls go to by name."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

import anyio
from anyio.abc import TaskGroup

from rcp_can.axis import Axis
from rcp_can.binding import Part
from rcp_can.bus import Bus
from rcp_can.config import CanConfig
from rcp_can.crew import by_rate, heard, make_axes, run_axes, simulated
from rcp_can.device import DevicePart
from rcp_can.diff_drive import DiffDrivePart
from rcp_can.eds_node import EdsPart
from rcp_can.health import Health
from rcp_can.joint_group import JointGroupPart
from rcp_can.motor import MotorPart
from rcp_can.raw import BusPart
from rcp_can.sdo import Sdo
from rcp_kernel.errors import ConfigError, UnknownPath
from rcp_kernel.spi import BaseBackend, Host, Progress

__all__ = ["CanBackend", "open_buses"]


class CanBackend(BaseBackend):
    """Several buses, and all that sits on them."""

    def __init__(self, host: Host, buses: dict[str, Bus], axes: dict[str, Axis]) -> None:
        self.buses, self.axes = buses, axes
        self._host = host
        self._parts: list[Part] = []
        self._owner: dict[str, Part] = {}

    def add(self, part: Part) -> None:
        """Declare what a part has.

        :raises ConfigError: another part has that name.
        """
        found = part.resources()
        for resource in found:
            if resource.name in self._owner:
                raise ConfigError(f"{resource.name} would stand for two things: rename one")
            self._owner[resource.name] = part
        self._parts.append(part)
        self._host.declare(*found)

    def _part(self, name: str) -> Part:
        if name not in self._owner:
            raise UnknownPath(f"there is no '{name}'")
        return self._owner[name]

    async def read(self, name: str) -> Any:
        """Return the present value."""
        return await self._part(name).read(name)

    async def write(self, name: str, value: Any) -> Any:
        """Bring a value into force."""
        return await self._part(name).write(name, value)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or service."""
        return await self._part(name).execute(name, value, progress)

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[object]:
        """Publish while somebody looks."""
        return self._watch(name)

    @asynccontextmanager
    async def _watch(self, name: str) -> AsyncGenerator[None]:
        with self._part(name).watch(name):
            yield

    async def halt(self) -> None:
        """Quick stop for all that moves; returns when every drive confirmed it."""
        await asyncio.gather(*(part.halt() for part in self._parts))


@asynccontextmanager
async def open_buses(config: CanConfig, host: Host) -> AsyncGenerator[CanBackend]:
    """Open every bus and what is configured on it; leaving lets go of all.

    :raises ConfigError: the configuration cannot be.
    :raises NotReady: a bus does not open.
    """
    health = Health(host)
    buses = {name: Bus(name, bus, host, health) for name, bus in config.buses.items()}
    axes = make_axes(config, buses, host, health)
    backend = CanBackend(host, buses, axes)
    lines = [BusPart(bus, host) for bus in buses.values()]
    devices = [
        DevicePart(name, device, buses[device.bus], host) for name, device in config.devices.items()
    ]
    nodes = [
        EdsPart(name, node, bus, _sdo(bus, node.node, axes.values()), host, health)
        for name, node in config.nodes.items()
        for bus in (buses[node.bus],)
    ]
    drives = [
        DiffDrivePart(name, drive, axes[drive.left], axes[drive.right])
        for name, drive in config.diff_drives.items()
    ]
    groups = [
        JointGroupPart(name, group, [axes[joint] for joint in group.joints], host)
        for name, group in config.joint_groups.items()
    ]
    for part in (*lines, *map(MotorPart, axes.values()), *devices, *nodes, *drives, *groups):
        backend.add(part)
    try:
        async with anyio.create_task_group() as tasks:
            await _start(tasks, buses.values())
            with simulated(config):
                for group in by_rate(axes.values()):
                    tasks.start_soon(run_axes, group)
                for node in nodes:
                    node.watched.start()
                await heard(axes.values(), config.grace, health)
                try:
                    yield backend
                finally:
                    for node in nodes:
                        node.watched.stop()
                    for closing in (*lines, *axes.values()):
                        await closing.close()
                    tasks.cancel_scope.cancel()
    except ExceptionGroup as group:
        first, *more = group.exceptions
        if more:
            raise
        raise first from None


def _sdo(bus: Bus, node: int, axes: Iterable[Axis]) -> Sdo:
    """Return the one client of a node's SDO server: that of its motor, if it is one."""
    for axis in axes:
        server = axis.drive.server
        if server is not None and axis.bus is bus and axis.drive.node == node:
            return server
    sdo = Sdo(bus, node)
    bus.listen(sdo.take, sdo.route)
    return sdo


async def _start(tasks: TaskGroup, buses: Iterable[Bus]) -> None:
    ready: list[asyncio.Event] = []
    for bus in buses:
        ready.append(asyncio.Event())
        tasks.start_soon(bus.run, ready[-1])
        tasks.start_soon(bus.count)
    for event in ready:
        await event.wait()
