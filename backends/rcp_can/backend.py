"""The CAN backend: open buses, and the parts that serve their resources."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Coroutine, Iterable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

import anyio
from anyio.abc import TaskGroup

from rcp_can.axis import Axis
from rcp_can.binding import Part
from rcp_can.bus import Bus
from rcp_can.commissioning import CommissioningPart, procedures_of
from rcp_can.config import CanConfig
from rcp_can.device import DevicePart
from rcp_can.dictionary import DictionaryPart
from rcp_can.diff_drive import DiffDrivePart
from rcp_can.dronecan_parts import dronecan_parts, dronecan_services
from rcp_can.eds_node import EdsPart
from rcp_can.excitation import excitations
from rcp_can.facts import Facts
from rcp_can.group_power import group_powers
from rcp_can.health import Health
from rcp_can.joint_group import JointGroupPart
from rcp_can.motor import MotorPart
from rcp_can.motor_group import (
    by_rate,
    make_axes,
    run_axes,
    shared_modes,
    simulated,
    wait_for_motors,
)
from rcp_can.raw import BusPart
from rcp_can.sdo import Sdo
from rcp_can.standstill import motion_of_all
from rcp_can.stop_plan import stop_plans
from rcp_can.traffic import TrafficPart
from rcp_kernel.errors import (
    AdapterUnavailable,
    ConfigError,
    DeviceTimeout,
    ModeForbids,
    RcpError,
    UnknownPath,
    UnsupportedOperation,
)
from rcp_kernel.model import Resource
from rcp_kernel.spi import (
    BaseBackend,
    Host,
    MotionState,
    Progress,
    Watchdog,
    check_fence,
)

__all__ = ["CanBackend", "open_buses"]


class CanBackend(BaseBackend):
    """Several buses and the devices on them."""

    on_loss = "hold"

    def __init__(self, host: Host, buses: dict[str, Bus], axes: dict[str, Axis]) -> None:
        self.buses, self.axes = buses, axes
        self._host = host
        self._parts: list[Part] = []
        self._owner: dict[str, Part] = {}

    def add(self, part: Part) -> None:
        """Declare the resources of a part.

        :raises ConfigError: another part has that name.
        """
        self._parts.append(part)
        self.declare(part, part.resources())

    def declare(
        self, part: Part, resources: Sequence[Resource], withdrawn: Sequence[str] = ()
    ) -> None:
        """Declare resources of a part, in place of some that it no longer has.

        :raises ConfigError: another part has that name.
        """
        self._host.withdraw(*withdrawn)
        for name in withdrawn:
            del self._owner[name]
        for resource in resources:
            if self._owner.get(resource.name, part) is not part:
                raise ConfigError(f"{resource.name} is defined twice: rename one")
            self._owner[resource.name] = part
        self._host.declare(*resources)

    def _part(self, name: str) -> Part:
        if name not in self._owner:
            raise UnknownPath(f"there is no '{name}'")
        return self._owner[name]

    async def read(self, name: str) -> Any:
        """Return the current value."""
        return await self._part(name).read(name)

    async def write(self, name: str, value: Any) -> Any:
        """Write a value."""
        return await self._part(name).write(name, value)

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Set the set-points of several motors in one cycle, or of none."""
        motors = {name: self._part(name) for name in values}
        targets = [(name, part) for name, part in motors.items() if isinstance(part, MotorPart)]
        if len(targets) < len(values):
            raise UnsupportedOperation("only set-points of motors are written as one")
        for name, motor in targets:
            try:
                motor.check(name, values[name])
            except RcpError as error:
                error.path = name
                raise
        check_fence()
        for name, motor in targets:
            motor.axis.await_cycle()
            motor.command(name, values[name])
        return {}

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or service."""
        return await self._part(name).execute(name, value, progress)

    def foresee(self, name: str, value: Any) -> None:
        """Refuse a motion whose motors accept no commands now, or that they cannot follow."""
        self._part(name).foresee(name, value)

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[object]:
        """Publish a resource while a client subscribes to it."""
        return self._watch(name)

    @asynccontextmanager
    async def _watch(self, name: str) -> AsyncGenerator[None]:
        with self._part(name).watch(name):
            yield

    async def halt(self) -> None:
        """Stop everything that moves; return when fresh feedback from every drive confirms it.

        :raises AdapterUnavailable: a motor cannot be reached; the others have been stopped.
        :raises DeviceTimeout: a motor was commanded to stop but rest could not be confirmed.
        """
        await self._all(part.halt() for part in self._parts)

    def motion(self, robot: str | None) -> MotionState | None:
        """Report whether all motors are at rest; devices with a DBC file have no measurement."""
        return motion_of_all(self.axes.values())

    def hold_stop(self, robot: str | None) -> None:
        """Repeat the stop for each motor not at rest, or enabled by another master."""
        for part in self._parts:
            part.hold_stop()

    async def hold(self, robot: str | None) -> None:
        """Bring all motors to rest along their ramps, and hold them with torque on.

        :raises RcpError: as `halt`.
        """
        reason = ModeForbids("the robot was commanded to hold")
        await self._all(part.hold(reason) for part in self._parts)

    async def recover(self, robot: str | None) -> str:
        """Discard earlier set-points and bring to rest whatever still moves."""
        try:
            await self.hold(robot)
        except AdapterUnavailable as error:
            return f"held the reachable motors ({error.message}); set-points discarded"
        return "held at rest; set-points discarded"

    def watchdogs(self) -> Sequence[Watchdog]:
        """List what stops each motor if the gateway stops sending, as far as known."""
        return [
            Watchdog(found.mechanism, found.within, found.verified, robot=axis.name)
            for axis in self.axes.values()
            for found in (axis.drive.protection,)
        ]

    async def _all(self, work: Iterable[Coroutine[Any, Any, None]]) -> None:
        """Await all coroutines even if some fail, then raise the failures together."""
        done = await asyncio.gather(*work, return_exceptions=True)
        failed = [each for each in done if isinstance(each, BaseException)]
        if not failed:
            return
        errors = [each for each in failed if isinstance(each, RcpError)]
        if len(errors) < len(failed):
            raise next(each for each in failed if not isinstance(each, RcpError))
        text = "; ".join(each.message for each in errors)
        if any(isinstance(each, AdapterUnavailable) for each in errors):
            raise AdapterUnavailable(text, remedy=errors[0].remedy)
        raise DeviceTimeout(text, details=errors[0].details)


@asynccontextmanager
async def open_buses(config: CanConfig, host: Host) -> AsyncGenerator[CanBackend]:
    """Open every configured bus and its devices; close them on exit.

    :raises ConfigError: the configuration is invalid.
    :raises NotReady: a bus does not open.
    """
    health = Health(host)
    buses = {name: Bus(name, bus, host, health) for name, bus in config.buses.items()}
    axes = make_axes(config, buses, host, health, Facts(config, host))
    backend = CanBackend(host, buses, axes)
    lines = [BusPart(bus, host) for bus in buses.values()]
    devices = [
        DevicePart(name, device, buses[device.bus], host) for name, device in config.devices.items()
    ]
    servers = {
        name: _sdo(buses[node.bus], node.node, axes.values()) for name, node in config.nodes.items()
    }
    nodes = [
        EdsPart(name, node, buses[node.bus], servers[name], host, health)
        for name, node in config.nodes.items()
    ]
    dictionaries = [
        DictionaryPart(name, node, servers[name]) for name, node in config.nodes.items()
    ]
    drives = [
        DiffDrivePart(name, drive, axes[drive.left], axes[drive.right], host)
        for name, drive in config.diff_drives.items()
    ]
    groups = [
        JointGroupPart(name, group, [axes[joint] for joint in group.joints], host)
        for name, group in config.joint_groups.items()
    ]
    dronecan = dronecan_parts(config, buses, axes.values(), host, health)
    powers = group_powers(config, drives, groups)
    motors = [MotorPart(axis, shared_modes(axis, axes.values())) for axis in axes.values()]
    commissioned = [
        CommissioningPart(axis, [*excitations(axis), *procedures_of(axis)])
        for axis in axes.values()
        if axis.config.commissioning
    ]
    traffic = [TrafficPart(bus, host) for bus in buses.values()]
    for part in (
        *lines,
        *traffic,
        *motors,
        *commissioned,
        *devices,
        *nodes,
        *dronecan,
        *dictionaries,
        *drives,
        *groups,
        *powers,
    ):
        backend.add(part)
    try:
        async with anyio.create_task_group() as tasks:
            await _start(tasks, buses.values())
            with simulated(config):
                for group in by_rate(axes.values()):
                    tasks.start_soon(run_axes, group)
                for node in nodes:
                    node.watched.start()
                for service in dronecan_services(config, buses):
                    tasks.start_soon(service)
                for part in dronecan:
                    part.start(backend.declare)
                plans = stop_plans(config, axes.values(), devices)
                for bus, plan in plans.items():
                    host.guard(f"can/{bus}", plan)
                await wait_for_motors(axes.values(), config.grace, health)
                try:
                    yield backend
                finally:
                    for bus in plans:
                        host.guard(f"can/{bus}", None)
                    for node in nodes:
                        node.watched.stop()
                    for closing in (*dronecan, *lines, *axes.values()):
                        await closing.close()
                    tasks.cancel_scope.cancel()
    except ExceptionGroup as group:
        first, *more = group.exceptions
        if more:
            raise
        raise first from None


def _sdo(bus: Bus, node: int, axes: Iterable[Axis]) -> Sdo:
    """Return the single SDO client of a node: its motor's, if it has one."""
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
