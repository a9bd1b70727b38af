"""The backend: dispatches each call to the vehicle of its resource."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from typing import Any

from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout, RcpError
from rcp_kernel.spi import BaseBackend, Host, MotionState, Progress, Watchdog
from rcp_mavlink.config import MavlinkConfig
from rcp_mavlink.described import checked
from rcp_mavlink.dialect import dialect
from rcp_mavlink.hub import Hub, open_hub
from rcp_mavlink.robot import Robot
from rcp_mavlink.vehicle import Vehicle

__all__ = ["MavlinkBackend", "open_mavlink"]

_POLL_PERIOD = 1.0  # s


class MavlinkBackend(BaseBackend):
    """The vehicles behind the links of one backend."""

    def __init__(self, hub: Hub, host: Host) -> None:
        self.hub, self._host = hub, host
        self.on_loss = hub.config.on_loss
        self.robots: dict[str, Robot] = {}
        """By path segment; empty for a single vehicle."""

    def found(self, vehicle: Vehicle) -> None:
        """Add a newly detected vehicle to the tree."""
        prefix = ""
        if self.hub.config.discover:
            prefix = self.hub.config.names.get(str(vehicle.system), f"vehicle{vehicle.system}")
        robot = self.robots[prefix] = Robot(self.hub, vehicle, self._host, prefix)
        robot.stop_if_latched()
        robot.restore()
        robot.begin()

    def changed(self, vehicle: Vehicle) -> None:
        """Report lost and returned vehicles."""
        own = [r for r in self.robots.values() if r.vehicle is vehicle and not vehicle.lost]
        for robot in own:  # before the report, whose listeners may request messages
            robot.stop.doubt()
            robot.stop_if_latched()
            robot.restore()
        lost = [v for v in self.hub.vehicles.values() if v.lost]
        if lost:
            detail = "; ".join(self.hub.silent(v) for v in lost)
            self._host.report(detail, down=len(lost) == len(self.hub.vehicles))
        else:
            self._host.report(None)
        for robot in own:
            robot.back()

    async def poll(self) -> None:
        """Monitor the vehicles, until cancelled."""
        while True:
            await asyncio.sleep(_POLL_PERIOD)
            for robot in self.robots.values():
                robot.poll()

    def _robot(self, name: str) -> tuple[Robot, str]:
        if not self.hub.config.discover:
            robot = self.robots.get("")
            if robot is not None:
                return robot, name
        else:
            branch, prefix, rest = [*name.split("/", 2), "", ""][:3]
            if prefix in self.robots:
                return self.robots[prefix], f"{branch}/{rest}"
        raise AdapterUnavailable(f"no vehicle connected for '{name}'")

    async def read(self, name: str) -> Any:
        """Return the current value."""
        robot, own = self._robot(name)
        return await robot.read(own)

    async def write(self, name: str, value: Any) -> Any:
        """Write a parameter or a set-point."""
        robot, own = self._robot(name)
        return await robot.write(own, value)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or service until telemetry confirms its end."""
        robot, own = self._robot(name)
        return await robot.execute(own, value, progress)

    def foresee(self, name: str, value: Any) -> None:
        """Refuse a flight that the vehicle would refuse now: its state, its fence."""
        robot, own = self._robot(name)
        robot.foresee(own, value)

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[object]:
        """Request the resource from the vehicle while entered."""
        robot, own = self._robot(name)
        return robot.watch(own, rate)

    # Stops

    def _meant(self, robot: str | None) -> list[Robot]:
        """List one vehicle by its name, or all of them.

        :raises AdapterUnavailable: it is not connected, so it was not stopped.
        """
        if robot is None or not self.hub.config.discover:
            meant = list(self.robots.values())
        else:
            meant = [self.robots[robot]] if robot in self.robots else []
        if not meant:
            raise AdapterUnavailable(f"{robot or 'the vehicle'} is not connected")
        return meant

    async def _each(self, robot: str | None, do: Callable[[Robot], Awaitable[Any]]) -> list[Any]:
        """Run something on every addressed vehicle, even if others fail.

        :raises RcpError: the most severe failure; names all affected vehicles.
        """
        meant = self._meant(robot)
        done = await asyncio.gather(*map(do, meant), return_exceptions=True)
        wrong = [
            (r, e) for r, e in zip(meant, done, strict=True) if isinstance(e, BaseException)
        ]  # fmt: skip
        for _, error in wrong:
            if not isinstance(error, RcpError):
                raise error
        if len(wrong) == 1:
            raise wrong[0][1]
        if wrong:
            text = "; ".join(f"{r.name_in_texts}: {e}" for r, e in wrong)
            lost = any(isinstance(e, AdapterUnavailable) for _, e in wrong)
            raise AdapterUnavailable(text) if lost else DeviceTimeout(text)
        return done

    async def halt(self) -> None:
        """Stop every vehicle by the configured steps; lost vehicles are sent the stop as well."""
        await self._each(None, lambda r: r.stop.halt())

    async def halt_robot(self, robot: str) -> None:
        """Stop one vehicle by the configured steps."""
        await self._each(robot, lambda r: r.stop.halt())

    def motion(self, robot: str | None) -> MotionState | None:
        """Report whether the vehicles are at rest, by telemetry; of several, the worst state."""
        try:
            meant = self._meant(robot)
        except AdapterUnavailable as error:
            return MotionState(None, str(error))
        states = [(r, r.stop.state()) for r in meant]
        order = (None, False, True)
        worst, state = min(states, key=lambda pair: order.index(pair[1].at_rest))
        if len(states) == 1:
            return state
        energised = [s.energised for _, s in states]
        any_energised = True if True in energised else None if None in energised else False
        return MotionState(state.at_rest, f"{worst.name_in_texts}: {state.detail}", any_energised)

    def hold_stop(self, robot: str | None) -> None:
        """Send the stop again, if due."""
        with suppress(AdapterUnavailable):  # stopped once it is heard again
            for each in self._meant(robot):
                each.stop.hold_stop()

    async def hold(self, robot: str | None) -> None:
        """Command a vehicle in the air to hold its position; does nothing on the ground."""
        await self._each(robot, lambda r: r.stop.hold())

    async def recover(self, robot: str | None) -> str:
        """Apply `on_loss` to a vehicle that is connected again."""
        done = await self._each(robot, lambda r: r.recovery.run(self.on_loss))
        return "; ".join(done)

    def watchdogs(self) -> Sequence[Watchdog]:
        """List what stops each vehicle when the gateway falls silent."""
        return [dog for r in self.robots.values() for dog in (*r.watchdogs.found, r.guard.watchdog)]


@asynccontextmanager
async def open_mavlink(config: MavlinkConfig, host: Host) -> AsyncGenerator[MavlinkBackend]:
    """Open the links and wait for the first vehicle; leaving restores its message rates.

    :raises ConfigError: the dialect or the parameter metadata cannot be loaded.
    :raises NotReady: a link cannot be opened, or no vehicle is connected.
    """
    messages = await asyncio.to_thread(dialect, config.dialect)
    await asyncio.to_thread(checked, config.parameters)
    async with open_hub(config, messages) as hub:
        backend = MavlinkBackend(hub, host)
        hub.found, hub.changed = backend.found, backend.changed
        await hub.first()
        await asyncio.sleep(0)
        polling = asyncio.create_task(backend.poll())
        try:
            yield backend
        finally:
            hub.found = hub.changed = lambda _: None
            polling.cancel()
            await asyncio.gather(polling, return_exceptions=True)
            for robot in backend.robots.values():
                await robot.close()
