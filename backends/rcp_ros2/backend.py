"""The backend: dispatches each call to the binding of its resource."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

from rcp_kernel.errors import AdapterUnavailable, InvalidValue
from rcp_kernel.spi import BaseBackend, Host, MotionState, Progress, Publication, Watchdog, unfenced
from rcp_protocol.timeouts import timeout
from rcp_ros2.binding import Binding, Shared
from rcp_ros2.catalog import Catalog
from rcp_ros2.config import Ros2Config
from rcp_ros2.graph import Graph, GraphWatch
from rcp_ros2.offers import GraphOffers
from rcp_ros2.parameters import Setting
from rcp_ros2.ros import contained, open_ros
from rcp_ros2.stops import Stops
from rcp_ros2.texts import Texts

__all__ = ["Ros2Backend", "open_ros2"]

_SETTLE = 0.6  # s for discovery at the start; a gateway waits 1 s for its backends


class Ros2Backend(BaseBackend):
    """One ROS 2 domain."""

    def __init__(self, catalog: Catalog, stops: Stops, on_loss: str) -> None:
        self.catalog = catalog
        self.stops = stops
        self.on_loss = on_loss
        self._offers = GraphOffers(catalog.shared) if catalog.shared.config.offers else None

    def _binding(self, name: str) -> Binding:
        binding = self.catalog.bindings.get(name)
        if binding is None:
            raise AdapterUnavailable(f"'{name}' has left the ROS graph")
        return binding

    async def read(self, name: str) -> Any:
        """Return the current value, with its time if its message has one."""
        value, stamp = await self._binding(name).measured()
        return value if stamp is None else Publication(name, value, stamp)

    async def write(self, name: str, value: Any) -> Any:
        """Publish a command, or set a parameter."""
        return await self._binding(name).write(value)

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Set several parameters of one node atomically.

        :raises InvalidValue: two of the paths are the same parameter.
        """
        bindings = {name: self._binding(name) for name in values}
        settings = {name: one for name, one in bindings.items() if isinstance(one, Setting)}
        if len(settings) < len(values) or len({one.node for one in settings.values()}) > 1:
            raise AdapterUnavailable("the parameters are no longer those of one node")
        parameters: dict[str, tuple[int, Any]] = {}
        for name, one in settings.items():
            if one.described.name in parameters:
                raise InvalidValue(
                    f"'{name}' is the same parameter as another of these paths",
                    path=name,
                    remedy="Write it by one of its paths.",
                )
            parameters[one.described.name] = one.described.kind, values[name]
        [node] = {one.node for one in settings.values()}

        def admit() -> None:
            for one in settings.values():
                one.admit()

        await node.set_together(parameters, admit)
        return {}

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Call a service, or run an action."""
        if self._offers is not None and self._offers.has(name):
            return await self._offers.execute(name, value, progress)
        return await self._binding(name).execute(value, progress)

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[object]:
        """Subscribe while entered, also to a binding that replaces the current one."""
        return self._watch(name, math.inf if rate is None else rate)

    @asynccontextmanager
    async def _watch(self, name: str, rate: float) -> AsyncGenerator[None]:
        rates = self.catalog.rates.setdefault(name, [])
        rates.append(rate)
        self._adjust(name)
        try:
            yield
        finally:
            rates.remove(rate)
            self._adjust(name)

    def _adjust(self, name: str) -> None:
        binding = self.catalog.bindings.get(name)
        rates = self.catalog.rates[name]
        if not rates:
            del self.catalog.rates[name]
        if binding is None:
            return
        if rates:
            binding.watched(max(rates))
        else:
            binding.unwatched()

    async def halt(self) -> None:
        """Publish safe values, cancel every goal and use all configured means of stopping.

        :raises AdapterUnavailable: it is unknown whether everything is at rest.
        :raises DeviceTimeout: something is not at rest.
        """
        await self.stops.halt(None)

    async def halt_robot(self, robot: str) -> None:
        """Stop one robot, as `halt`."""
        await self.stops.halt(robot)

    def motion(self, robot: str | None) -> MotionState:
        """Report whether a robot is at rest: by odometry, otherwise by delivered safe values."""
        return self.stops.motion(robot)

    def hold_stop(self, robot: str | None) -> None:
        """Keep a robot stopped; the ROS thread repeats the stop."""
        self.stops.hold_stop(robot)

    async def hold(self, robot: str | None) -> None:
        """Publish safe values and cancel every goal, without the configured means."""
        await self.stops.halt(robot)

    async def recover(self, robot: str | None) -> str:
        """Cancel goals that were lost with their server, or with a previous gateway process."""
        return await self.stops.recover(robot)

    def watchdogs(self) -> Sequence[Watchdog]:
        """Report per robot that no watchdog is known."""
        return self.stops.watchdogs()


@asynccontextmanager
async def open_ros2(config: Ros2Config, host: Host) -> AsyncGenerator[Ros2Backend]:
    """Join a ROS 2 domain; release everything on exit.

    :raises ConfigError: rclpy is missing.
    :raises NotReady: ROS 2 did not start, or failed later.
    """
    texts = Texts(config.types, config.interfaces)
    began = time.monotonic()
    with texts.used():
        async with open_ros(config, host) as ros:
            shared = Shared(ros, config, host)
            catalog = Catalog(shared, texts)
            stops = Stops(shared, catalog)

            def update(graph: Graph) -> None:
                catalog.update(graph)
                stops.update(graph)

            watch = GraphWatch(ros, catalog.matters, update)
            watch.on_poll.extend(
                (shared.subscriptions.refresh, shared.pulses.poll, lambda: _poll(shared))
            )
            host.discovering(active=True)
            await catalog.place_mapped()
            await ros.call(watch.start)
            with unfenced():
                following = asyncio.create_task(stops.follow(), name="ros2 stops")
            try:
                await _settle(catalog, min(config.grace, _SETTLE - (time.monotonic() - began)))
                yield Ros2Backend(catalog, stops, config.on_loss)
            finally:
                following.cancel()
                await stops.close()
                await catalog.close()


async def _settle(catalog: Catalog, limit: float) -> None:
    """Wait for discovery, so that most paths exist when the backend is ready.

    Discovery occasionally takes 3 s, for which the gateway's start does not wait.
    """
    if limit > 0:
        with contextlib.suppress(TimeoutError):
            async with timeout(limit):
                await catalog.complete.wait()


def _poll(shared: Shared) -> None:
    for poll in list(shared.on_poll):
        contained(poll)()
