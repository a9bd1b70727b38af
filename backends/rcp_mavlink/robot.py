"""One vehicle: its parts, its life from the first heartbeat on, and the calls of the kernel.

How a message becomes a sample is in `reception.py`, how an action becomes a command in `actions.py`.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncGenerator, Coroutine
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from functools import partial
from typing import Any

from msgspec.structs import replace

from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.spi import Host, Progress
from rcp_mavlink import messages as m
from rcp_mavlink.actions import Actions
from rcp_mavlink.arming_block import ArmingBlock
from rcp_mavlink.arming_sticks import ArmingSticks
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.component_metadata import ComponentMetadata
from rcp_mavlink.described import Described
from rcp_mavlink.equipment import Equipment
from rcp_mavlink.files import Files
from rcp_mavlink.flights import Flights
from rcp_mavlink.forwarding import FRAMES, SEND, Forwarding
from rcp_mavlink.hub import Hub
from rcp_mavlink.intervals import FASTEST, Intervals
from rcp_mavlink.journeys import Journeys
from rcp_mavlink.measurement import Measurement
from rcp_mavlink.motion import Motion
from rcp_mavlink.parameter_resources import ParameterResources
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.plans import Plans
from rcp_mavlink.reception import Reception
from rcp_mavlink.recovery import Recovery
from rcp_mavlink.resources import resources
from rcp_mavlink.restart import Restarts
from rcp_mavlink.sensors import BASE, ESTIMATOR
from rcp_mavlink.setpoints import Setpoints
from rcp_mavlink.speed_controllers import ESCS, SpeedControllers
from rcp_mavlink.speeds import SpeedLimit
from rcp_mavlink.stop import Stop
from rcp_mavlink.stop_plan import GuardPlan
from rcp_mavlink.telemetry import Telemetry
from rcp_mavlink.telemetry_events import TelemetryEvents
from rcp_mavlink.terrain import TERRAIN, Terrain
from rcp_mavlink.traffic import TRAFFIC, Traffic
from rcp_mavlink.tree import VehicleTree
from rcp_mavlink.vehicle import Vehicle
from rcp_mavlink.watchdogs import Watchdogs

__all__ = ["Robot"]

_RETRY_AFTER = 3.0  # s without a required message


class Robot:
    """One vehicle; `prefix` is its name if there are several."""

    def __init__(self, hub: Hub, vehicle: Vehicle, host: Host, prefix: str) -> None:
        self.vehicle = vehicle
        self._hub, self._host = hub, host
        self._tree = tree = VehicleTree(host, prefix)
        config = hub.config
        self._tasks: set[asyncio.Task[None]] = set()
        self._closed = False
        self._commands = Commands(hub, vehicle)
        self.intervals = Intervals(vehicle, self._commands, _base_rates(hub, vehicle))
        self.measurement = Measurement(vehicle, config)
        self.motion = Motion(vehicle, self._commands, self.measurement)
        self.plans = Plans(hub, vehicle)
        self.parameters = Parameters(hub, vehicle, self._on_parameter)
        self.setpoints = Setpoints(hub, vehicle, self.motion, self.intervals.request)
        self.speed_limit = SpeedLimit(vehicle, self.parameters)
        self._terrain = Terrain(
            hub, vehicle, self.intervals, tree.publish, hub.elevation, self._start
        )
        journeys = Journeys(
            vehicle, self._commands, self.motion, self.parameters, self.speed_limit, self._terrain
        )
        self._equipment = Equipment(
            hub, vehicle, self._commands, self.intervals, self.motion, self.parameters,
            self.setpoints, self.speed_limit, journeys, self.plans,
        )  # fmt: skip
        self.stop = Stop(
            hub, vehicle, self._commands, self.measurement,
            end_setpoints=self._end_all, beside=self._equipment.state, latched=tree.is_latched,
        )  # fmt: skip
        self.recovery = Recovery(vehicle, self.motion, self.stop)
        self.watchdogs = Watchdogs(vehicle, config, self.parameters, tree.scope)
        self.guard = GuardPlan(hub, vehicle, host, self.stop, tree.scope)
        self.telemetry = Telemetry(
            hub, vehicle, self.intervals, host, name=tree.name, start=self._start
        )
        self.telemetry_events = TelemetryEvents(hub, vehicle, tree.publish, self._run_prearm_checks)
        self.traffic = Traffic(tree.publish)
        self.escs = SpeedControllers(vehicle, self.intervals, tree.publish, config.timeout)
        self._requested = {ESCS: self.escs, TERRAIN: self._terrain}
        """What reads and subscriptions request from the vehicle, beside single messages."""
        self._reception = Reception(
            vehicle, tree, self.measurement, self.parameters, self.telemetry,
            self.telemetry_events, traffic=self.traffic, escs=self.escs, terrain=self._terrain,
            guard=self.guard, restarted=self._request_messages,
        )  # fmt: skip
        self._flights = Flights(vehicle, self._commands, self.motion, self.parameters, journeys)
        sticks = ArmingSticks(vehicle, self.intervals, self.parameters)
        self._arming_block = ArmingBlock(vehicle, self._commands, self.motion, sticks)
        files = Files(hub, vehicle)
        offered = ComponentMetadata(hub, vehicle, self._commands, files)
        described = Described(config.parameters, files, offered)
        self._parameter_resources = ParameterResources(
            vehicle, tree, self._commands, self.parameters, described, config.params,
            listed=lambda: self._start(self.watchdogs.verify()),
        )  # fmt: skip
        self._forwarding = Forwarding(hub, vehicle)
        restarts = Restarts(
            vehicle, self._commands, self.motion, end_setpoints=self.setpoints.end, back=self.back
        )
        self._actions = Actions(
            hub, vehicle, self._commands, self.intervals, self.motion, self.setpoints,
            parameters=self.parameters, parameter_resources=self._parameter_resources,
            described=described, plans=self.plans, flights=self._flights,
            equipment=self._equipment, terrain=self._terrain, files=files,
            forwarding=self._forwarding, arming_block=self._arming_block, restarts=restarts,
            end_writes=self._end_writes,
        )  # fmt: skip

    @property
    def name_in_texts(self) -> str:
        """Its name in messages and in the log."""
        return self._tree.prefix or f"vehicle {self.vehicle.system}"

    # Lifecycle

    def begin(self) -> None:
        """Declare its resources; request its messages and parameters."""
        tree, sensors, derived = self._tree, self.telemetry.sensors, self.telemetry.deriveds
        tree.declare(resources(self._hub, self.vehicle, sensors, derived, tree.scope))
        if self._hub.config.forward:
            tree.declare(replace(r, name=tree.name(r.name)) for r in self._forwarding.resources())
        tree.describe(self.vehicle)
        self.vehicle.on_frame.append(self._reception.frame)
        self.vehicle.on_text.append(self.telemetry_events.text)
        self.telemetry_events.begin()
        self.traffic.poll()
        self.telemetry.request_time()
        self._request_messages()
        self._start(self._parameter_resources.list())

    def back(self) -> None:
        """Request everything again: the vehicle is connected again."""
        self._request_messages()
        if not self.parameters.complete.is_set():
            self._start(self._parameter_resources.list())

    def _request_messages(self) -> None:
        """Request what is sent periodically, and what is not, without waiting for it."""
        self.intervals.begin()
        for message in ("AUTOPILOT_VERSION", "HOME_POSITION"):
            self._start(self.telemetry.first(message))

    async def close(self) -> None:
        """Release the vehicle."""
        self._closed = True
        self._end_all()
        self._arming_block.close()
        self.guard.take_back()
        await self.stop.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.intervals.close()
        self.vehicle.lose("the gateway has released the vehicle")
        self.vehicle.on_frame.clear()
        self.vehicle.on_text.clear()

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        if self._closed:  # the vehicle may reconnect before the links are closed
            work.close()
            return
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def poll(self) -> None:
        """Repeat requests for messages that do not arrive; called periodically."""
        now = time.monotonic()
        received = self.vehicle.received_at.get(
            "GLOBAL_POSITION_INT", self.vehicle.last_message_at - 1
        )
        if not self.vehicle.lost and now - received > _RETRY_AFTER:
            self.intervals.begin()
        if self.vehicle.lost:  # the uplink may work although the downlink does not
            self.stop_if_latched()
        self._equipment.keep_ending()
        self._arming_block.keep_releasing()
        self.telemetry_events.links()
        self.traffic.poll()
        self.guard.renew()
        self.telemetry.poll()

    def _on_parameter(self, name: str) -> None:
        self._parameter_resources.publish(name)

    def _run_prearm_checks(self) -> None:
        self._commands.send_once(Command(401))

    def _end_writes(self) -> None:
        """End whatever is held by writes."""
        self.setpoints.end()
        self._equipment.end_writes()

    def _end_all(self) -> None:
        """End what is held by writes, and what moves beside the flight."""
        self._end_writes()
        self._equipment.end()

    # Calls from the kernel

    async def read(self, name: str) -> Any:
        """Return the present value of one of its own paths."""
        self.vehicle.check()
        if self.telemetry.has(name):
            return await self.telemetry.read(name)
        if name == "param/speed_limit":
            return await self.speed_limit.read()
        if name.startswith("param/"):
            return await self._parameter_resources.read(name.removeprefix("param/"))
        if name == TRAFFIC:
            return self.traffic.value()
        if name in self._requested:
            return await self._requested[name].read()
        value = self.telemetry_events.value(name)
        if value is None:
            raise AdapterUnavailable(f"no value for '{name}' received yet")
        return value

    async def write(self, name: str, value: Any) -> Any:
        """Apply a value."""
        if name == "param/speed_limit":
            limit = await self.speed_limit.write(value)
            await self._flights.keep_limit()
            return limit
        if name.startswith("param/"):
            own = name.removeprefix("param/")
            written = await self._parameter_resources.write(own, value)
            if self.speed_limit.depends_on(own):
                await self._flights.keep_limit()
            return written
        self.vehicle.check()
        if name == SEND:
            return self._forwarding.write(value)
        if name in self._equipment.writes:
            await self._equipment.writes[name](value)
        elif name == "actuator/velocity":
            y, z = getattr(value, "y", 0.0), getattr(value, "z", 0.0)
            own = m.Velocity(value.x, y, z, value.yaw_rate)
            await self.setpoints.velocity(own, partial(self._limited, strictly=False))
        elif name == "actuator/cmd_vel":
            linear = value.linear
            own = m.Velocity(linear.x, linear.y, linear.z, value.angular.z)
            await self.setpoints.velocity(own, partial(self._limited, strictly=True))
        else:
            await self.setpoints.attitude(value)
        return None

    def _limited(self, value: m.Velocity, *, strictly: bool) -> m.Velocity:
        """Return a velocity of the same direction within the speed limit over the ground."""
        speed = math.hypot(value.x, value.y)
        share = self.speed_limit.kept(speed, strictly=strictly) / speed if speed else 1.0
        return replace(value, x=value.x * share, y=value.y * share)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or service."""
        return await self._actions.run(name, value, progress)

    def foresee(self, name: str, value: Any) -> None:
        """Refuse a dry run of what would be refused now."""
        self.vehicle.check()
        if name == "action/move_to":
            self.measurement.check()
        self._flights.foresee(name, value)

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[object]:
        """Request a message at a rate while entered."""
        if name == FRAMES:
            return self._tapped()
        rate = FASTEST if rate is None else min(rate, FASTEST)
        source = self._requested.get(name)
        return self.telemetry.watched(name, rate) if source is None else source.watched(rate)

    @asynccontextmanager
    async def _tapped(self) -> AsyncGenerator[None]:
        with self._forwarding.watched(self._tree.publish):
            yield

    def stop_if_latched(self) -> None:
        """Send the stop first of all if the vehicle is latched, even while it is lost."""
        if self._tree.is_latched():
            self.stop.hold_stop()

    def restore(self) -> None:
        """Let the kernel stop the vehicle or apply `on_loss`: it is connected again."""
        self._host.link_restored(self._tree.scope)


def _base_rates(hub: Hub, vehicle: Vehicle) -> dict[str, float]:
    """Return the rates (Hz) of the messages that the gateway itself needs."""
    rate = hub.config.rate
    base = {name: rate if "POSITION" in name else min(2.0, rate) for name in BASE}
    base |= Traffic.base(hub.dialect)
    base |= Terrain.base(hub.dialect, vehicle.family, served=hub.elevation is not None)
    if ESTIMATOR in hub.dialect.by_name and not vehicle.family.px4:
        base[ESTIMATOR] = min(2.0, rate)
    return base
