"""One vehicle in the tree: its resources, and their reads, writes and executions."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine, Iterable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

from msgspec.structs import replace

from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceTimeout,
    PreconditionFailed,
    UnsupportedOperation,
)
from rcp_kernel.model import Resource
from rcp_kernel.spi import Anchor, Host, Progress
from rcp_mavlink import messages as m
from rcp_mavlink.arming_block import ArmingBlock
from rcp_mavlink.arming_sticks import ArmingSticks
from rcp_mavlink.calibration import Calibration
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.component_metadata import ComponentMetadata
from rcp_mavlink.described import Described
from rcp_mavlink.direct_commands import DirectCommands
from rcp_mavlink.equipment import Equipment
from rcp_mavlink.files import Files
from rcp_mavlink.flights import Flights
from rcp_mavlink.forwarding import FRAMES, SEND, Forwarding
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.identity import describe
from rcp_mavlink.imaging import Imaging
from rcp_mavlink.intervals import FASTEST, Intervals
from rcp_mavlink.journeys import Journeys
from rcp_mavlink.logs import Logs
from rcp_mavlink.measurement import Measurement
from rcp_mavlink.missions import Missions
from rcp_mavlink.motion import Motion
from rcp_mavlink.paramcoding import REAL
from rcp_mavlink.parameter_defaults import ParameterDefaults
from rcp_mavlink.parameter_hazards import check_latched
from rcp_mavlink.parameter_transfer import ParameterTransfer
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.plan_transfer import PlanTransfer
from rcp_mavlink.plans import FENCE, MISSION, RALLY, Plans
from rcp_mavlink.recovery import Recovery
from rcp_mavlink.resources import parameter, resources
from rcp_mavlink.restart import watched
from rcp_mavlink.sensors import BASE, ESTIMATOR
from rcp_mavlink.setpoints import Setpoints
from rcp_mavlink.speed_controllers import ESCS, SpeedControllers
from rcp_mavlink.speeds import SpeedLimit
from rcp_mavlink.stop import Stop
from rcp_mavlink.stop_plan import GuardPlan
from rcp_mavlink.telemetry import TIMED, Telemetry
from rcp_mavlink.telemetry_events import TelemetryEvents
from rcp_mavlink.terrain import TERRAIN, Terrain
from rcp_mavlink.traffic import TRAFFIC, Traffic
from rcp_mavlink.vehicle import Vehicle
from rcp_mavlink.watchdogs import Watchdogs

__all__ = ["Robot"]

_RETRY_AFTER = 3.0  # s without a required message
_GLOBAL = 33
_REBOOTED = 10.0  # s by which the vehicle's clock must have gone back
_FIRST_POSITION = 3.0  # s
_ALLOWED_BLIND = ("action/land", "action/rtl", "action/return_home")
_RESTING = 5.0  # s to come to rest before the motors are stopped
_COMING_BACK = 30.0  # s for a reboot
_SYSTEM_TIME, _ASKING = 2.0, 0.5  # a message with its clock, and s between requests for it

Verb = Callable[[Any, Progress], Awaitable[Any]]


class Robot:
    """One vehicle; `prefix` is its name if there are several."""

    def __init__(self, hub: Hub, vehicle: Vehicle, host: Host, prefix: str) -> None:
        self.vehicle = vehicle
        self._hub, self._host, self._prefix = hub, host, prefix
        config = hub.config
        self._commands = Commands(hub, vehicle)
        base = {name: config.rate if "POSITION" in name else min(2.0, config.rate) for name in BASE}
        base |= Traffic.base(hub.dialect)
        base |= Terrain.base(hub.dialect, vehicle.family, served=hub.elevation is not None)
        if ESTIMATOR in hub.dialect.by_name and not vehicle.family.px4:
            base[ESTIMATOR] = min(2.0, config.rate)
        self.intervals = Intervals(vehicle, self._commands, base)
        self.measurement = Measurement(vehicle, config)
        self.motion = Motion(vehicle, self._commands, self.measurement)
        self.plans = Plans(hub, vehicle)
        self.parameters = Parameters(hub, vehicle, self._on_parameter)
        self.setpoints = Setpoints(hub, vehicle, self.motion, self.intervals.request)
        self.speed_limit = SpeedLimit(vehicle, self.parameters)
        self._terrain = Terrain(
            hub, vehicle, self.intervals, self._publish, hub.elevation, self._start
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
            end_setpoints=self._end_all, beside=self._equipment.state,
            latched=lambda: host.is_latched(self.scope),
        )  # fmt: skip
        self.recovery = Recovery(vehicle, self.motion, self.stop)
        self.watchdogs = Watchdogs(vehicle, config, self.parameters, self.scope)
        self.guard = GuardPlan(hub, vehicle, host, self.stop, self.scope)
        self.telemetry = Telemetry(
            hub, vehicle, self.intervals, host, name=self.name, start=self._start
        )
        self._declared: set[str] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._closed = False
        self._booted = 0  # ms, the last reported time since boot
        self._home: tuple[float, float, float] | None = None
        """The home that the gateway knows as the origin of the map."""
        self.telemetry_events = TelemetryEvents(
            hub, vehicle, self._publish, self._run_prearm_checks
        )
        self.traffic = Traffic(self._publish)
        self.escs = SpeedControllers(vehicle, self.intervals, self._publish, config.timeout)
        self._requested = {ESCS: self.escs, TERRAIN: self._terrain}
        """What reads and subscriptions request from the vehicle, beside single messages."""
        self._heeded: dict[int, Callable[[Frame], None]] = {
            **dict.fromkeys(TelemetryEvents.heeded, self.telemetry_events.frame),
            **dict.fromkeys(self.escs.heeded, self.escs.frame),
            **dict.fromkeys(Traffic.heeded, self.traffic.frame),
            **self._terrain.heeded,
            **dict.fromkeys(TIMED, self.telemetry.timed),
            0: self._heartbeat,
            22: self.parameters.take,  # PARAM_VALUE
            32: self._positioned,  # LOCAL_POSITION_NED
            33: self._positioned,  # GLOBAL_POSITION_INT
            148: self._describe,  # AUTOPILOT_VERSION
            242: self._homed,  # HOME_POSITION
        }
        self._flights = Flights(vehicle, self._commands, self.motion, self.parameters, journeys)
        sticks = ArmingSticks(vehicle, self.intervals, self.parameters)
        self._arming_block = ArmingBlock(vehicle, self._commands, self.motion, sticks)
        calibration = Calibration(
            vehicle,
            self._commands,
            self.intervals,
            self.motion,
            self.parameters,
            self._arming_block,
        )
        missions = Missions(vehicle, self._commands, self.plans, self.motion)
        leading = {
            **self._flights.verbs(), **self._equipment.leading(), "action/mission/run": missions.run
        }  # fmt: skip
        logs, files = Logs(hub, vehicle), Files(hub, vehicle)
        offered = ComponentMetadata(hub, vehicle, self._commands, files)
        self._described = Described(config.parameters, files, offered)
        self._forwarding = Forwarding(hub, vehicle)
        transfer = ParameterTransfer(
            vehicle,
            self.parameters,
            self._commands,
            self._described,
            self._reboot,
            self._check_latched,
        )
        plan_files = PlanTransfer(vehicle, self.plans)
        direct = DirectCommands(hub.dialect.module, self._commands, config.commands)
        self._verbs: dict[str, Verb] = {
            "action/arm": self.motion.arm,
            "action/disarm": self.motion.disarm,
            "action/set_mode": self._set_mode,
            **{name: self._ending(name, verb) for name, verb in leading.items()},
            **missions.verbs(),
            **self._terrain.verbs(),
            **self._equipment.verbs(),
            "action/mission/resume": self._seen_to_move(missions.resume),
            **Imaging(hub, vehicle, self._commands, self.intervals, files).verbs(),
            **calibration.verbs(),
            "service/mission/download": lambda _, __: self._download(MISSION),
            "service/mission/clear": lambda _, __: self._upload(MISSION, m.Items(())),
            "service/fence/upload": lambda items, _: self._upload(FENCE, items),
            "service/fence/download": lambda _, __: self._download(FENCE),
            "service/rally/upload": lambda items, progress: self._upload(RALLY, items, progress),
            "service/rally/download": lambda _, __: self._download(RALLY),
            "service/log/list": logs.list,
            "service/log/read": logs.read,
            **files.verbs(),
            "service/param/read": self._read_parameter,
            "service/param/save": self._save,
            "service/param/export": transfer.export,
            "service/param/compare": transfer.compare,
            "action/param/load": transfer.load,
            "action/param/reset": transfer.reset,
            **ParameterDefaults(files).verbs(),
            "service/plan/export": plan_files.export,
            "action/plan/load": plan_files.load,
            "service/command": direct.send,
            "service/commands": direct.list,
            "service/reboot": lambda _, __: self._reboot(),
            "service/reset_system": self._reset,
            "service/enable": self.motion.arm,
            "service/disable": self.motion.disarm,
            "service/mavlink/ask": self._forwarding.ask,
        }

    @property
    def scope(self) -> str | None:
        """Its name for the kernel if there are several; None: the whole backend."""
        return self._prefix or None

    @property
    def name_in_texts(self) -> str:
        """Its name in messages and in the log."""
        return self._prefix or f"vehicle {self.vehicle.system}"

    def name(self, name: str) -> str:
        """Return the path in the tree for one of the vehicle's own paths."""
        if not self._prefix:
            return name
        branch, _, rest = name.partition("/")
        return f"{branch}/{self._prefix}/{rest}"

    # Lifecycle

    def begin(self) -> None:
        """Declare its resources; request its messages and parameters."""
        sensors, derived = self.telemetry.sensors, self.telemetry.deriveds
        self._declare(resources(self._hub, self.vehicle, sensors, derived, self.scope))
        if self._hub.config.forward:
            self._declare(
                [replace(r, name=self.name(r.name)) for r in self._forwarding.resources()]
            )
        self._describe()
        self.vehicle.on_frame.append(self._frame)
        self.vehicle.on_text.append(self.telemetry_events.text)
        self.telemetry_events.begin()
        self.traffic.poll()
        self.intervals.begin()
        self.telemetry.request_time()
        self._request_once()
        self._start(self._list_parameters())

    def back(self) -> None:
        """Request everything again: the vehicle is connected again."""
        self.intervals.begin()
        self._request_once()
        if not self.parameters.complete.is_set():
            self._start(self._list_parameters())

    def _request_once(self) -> None:
        """Request what is not sent periodically, without waiting for it."""
        for message in ("AUTOPILOT_VERSION", "HOME_POSITION"):
            self._start(self.telemetry.first(message))

    def _describe(self, _: Frame | None = None) -> None:
        """Tell what it is, as far as it has said."""
        self._host.describe(describe(self.vehicle), self.scope)

    def _declare(self, resources: list[Resource]) -> None:
        if self._prefix:
            resources = [replace(resource, robot=self._prefix) for resource in resources]
        self._host.declare(*resources)
        self._declared.update(resource.name for resource in resources)

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

    # Receiving

    def _publish(self, name: str, value: Any) -> None:
        full = self.name(name)
        if full in self._declared:
            self._host.publish(full, value)

    def _frame(self, frame: Frame) -> None:
        self.telemetry.frame(frame)
        heed = self._heeded.get(frame.definition.id)
        if heed is not None:
            heed(frame)

    def _heartbeat(self, frame: Frame) -> None:
        self.telemetry_events.frame(frame)
        self.guard.renew()

    def _positioned(self, frame: Frame) -> None:
        self.measurement.take_position()
        if frame.definition.id == _GLOBAL:
            self._see_reboot(frame)

    def _homed(self, _: Frame) -> None:
        """Tell where the map is."""
        home = self.vehicle.home
        if home is not None and home != self._home:
            self._home = home
            lat, lon, altitude = home
            anchor = Anchor(latitude=lat, longitude=lon, altitude=altitude)
            self._host.anchor(anchor, self.scope)

    def _see_reboot(self, frame: Frame) -> None:
        """Detect a reboot by its clock; a reboot resets the requested rates."""
        clock = int.from_bytes(frame.payload[:4], "little")
        if clock + _REBOOTED * 1000 < self._booted:
            self.telemetry_events.boot()
            self.telemetry.forget_time()
            self.intervals.begin()
            self._request_once()  # it may have other firmware
        self._booted = clock

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

    def _run_prearm_checks(self) -> None:
        self._commands.send_once(Command(401))

    # Parameters

    async def _list_parameters(self) -> None:
        await self.parameters.list()
        self._start(self.watchdogs.verify())
        published = await self._described.load()
        patterns = self._hub.config.params
        names = [n for n in self.parameters.known if any(fnmatchcase(n, p) for p in patterns)]
        made = [
            parameter(self.name(f"param/{name}"), name, self.parameters.known[name].type, published)
            for name in sorted(names)
        ]
        if made:
            self._declare(made)
        for name in names:
            self._on_parameter(name)

    def _on_parameter(self, name: str) -> None:
        full = self.name(f"param/{name}")
        if full in self._declared:
            self._host.publish(full, self._value(name))

    def _value(self, name: str) -> float | int:
        known = self.parameters.known[name]
        whole = known.type < REAL and math.isfinite(known.value)
        return int(known.value) if whole else known.value

    def _check_latched(self, names: Iterable[str]) -> None:
        if self._host.is_latched(self.scope):
            check_latched(names, armed=self.vehicle.armed)

    async def _read_parameter(self, given: m.ReadParam, _: Progress) -> m.ParamValue:
        return m.ParamValue(given.name, await self.parameters.read(given.name))

    async def _save(self, _: None, __: Progress) -> None:
        """Have PX4 store its parameters; ArduPilot has stored each at once, and refuses to be asked."""
        if self.vehicle.family.px4:
            await self._commands.send(Command(245, (1.0, 0.0, 0.0, 0.0)), "save parameters")

    # Plans and the rest

    async def _upload(
        self, kind: int, items: m.Items, progress: Progress | None = None
    ) -> m.Uploaded:
        """Replace a plan; with progress if a refusal may leave a part of it."""
        told = None if progress is None else lambda part: progress(fraction=part)
        return m.Uploaded(await self.plans.upload(kind, items.items, told))

    async def _download(self, kind: int) -> m.Items:
        return m.Items(await self.plans.download(kind))

    async def _reboot(self) -> None:
        """Reboot the vehicle; completes when it has restarted and its heartbeats return.

        :raises DeviceTimeout: it was not seen to restart, or has not come back.
        """
        vehicle = self.vehicle
        with watched(vehicle) as restart:
            await self._commands.send(Command(246, (1.0, 0.0, 0.0, 0.0)), "reboot")
            end = vehicle.away_until = time.monotonic() + _COMING_BACK
            try:  # it goes on for a while after it has accepted
                while not await vehicle.until(lambda: restart.done, _ASKING):
                    if time.monotonic() > end:
                        raise DeviceTimeout("reboot: accepted, but the vehicle has not restarted")
                    self._commands.send_once(Command(512, (_SYSTEM_TIME, 0.0, 0.0, 0.0)))
            finally:
                vehicle.away_until = 0.0
        self.back()

    async def _reset(self, _: None, progress: Progress) -> None:
        """Stop, disarm and reboot the vehicle.

        :raises PreconditionFailed: it may be in the air, where a reboot would make it fall.
        """
        vehicle = self.vehicle
        if vehicle.family.flies and vehicle.armed and vehicle.landed is not True:
            raise PreconditionFailed("reset: the vehicle is in the air", remedy="Land it first.")
        self.setpoints.end()
        if vehicle.armed:
            await self.motion.hold()
            await vehicle.until(lambda: self.motion.rests, _RESTING)
            await self.motion.disarm(None, progress)
        await self._reboot()

    async def _set_mode(self, given: m.SetMode, progress: Progress) -> m.SetMode:
        family = self.vehicle.family
        if given.mode.upper() == family.auto:
            self.measurement.check()
        if family.px4 and given.mode.upper() == family.led != self.vehicle.mode:
            await self.setpoints.offboard()
        return await self.motion.set_mode(given, progress)

    def _end_writes(self) -> None:
        """End whatever is held by writes."""
        self.setpoints.end()
        self._equipment.end_writes()

    def _end_all(self) -> None:
        """End what is held by writes, and what moves beside the flight."""
        self._end_writes()
        self._equipment.end()

    def _ending(self, name: str, verb: Verb) -> Verb:
        """Wrap a command so that it ends the active set-points."""
        verb = verb if name in _ALLOWED_BLIND else self._seen_to_move(verb)

        async def run(given: Any, progress: Progress) -> Any:
            self._end_writes()
            return await verb(given, progress)

        return run

    def _seen_to_move(self, verb: Verb) -> Verb:
        """Refuse motion while the position is too old to observe it."""

        async def run(given: Any, progress: Progress) -> Any:
            if math.isinf(self.measurement.position_age):  # it may just have been requested
                await self.vehicle.until(lambda: not self.measurement.stale(), _FIRST_POSITION)
            self.measurement.check()
            return await verb(given, progress)

        return run

    # Calls from the kernel

    async def read(self, name: str) -> Any:
        """Return the present value of one of its own paths."""
        self.vehicle.check()
        if self.telemetry.has(name):
            return await self.telemetry.read(name)
        if name == "param/speed_limit":
            return await self.speed_limit.read()
        if name.startswith("param/"):
            own = name.removeprefix("param/")
            await self.parameters.read(own)
            return self._value(own)
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
            self._check_latched((own,))
            await self.parameters.write(own, value)
            if self.speed_limit.depends_on(own):
                await self._flights.keep_limit()
            return self._value(own)
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
        verb = self._verbs.get(name)
        if verb is None:
            raise UnsupportedOperation(f"'{name}' cannot be executed")
        self.vehicle.check()
        return await verb(value, progress)

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
        with self._forwarding.watched(self._publish):
            yield

    def stop_if_latched(self) -> None:
        """Send the stop first of all if the vehicle is latched, even while it is lost."""
        if self._host.is_latched(self.scope):
            self.stop.hold_stop()

    def restore(self) -> None:
        """Let the kernel stop the vehicle or apply `on_loss`: it is connected again."""
        self._host.link_restored(self.scope)
