"""From an action or service to the part of the backend that carries it out.

Each part turns its input into a `Command` of `commands.py`, which sends it until the vehicle
acknowledges it; `hub.py` packs it into bytes for the link over which the vehicle was heard last.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from typing import Any

from rcp_kernel.errors import UnsupportedOperation
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.arming_block import ArmingBlock
from rcp_mavlink.calibration import Calibration
from rcp_mavlink.commands import Commands
from rcp_mavlink.described import Described
from rcp_mavlink.direct_commands import DirectCommands
from rcp_mavlink.equipment import Equipment
from rcp_mavlink.files import Files
from rcp_mavlink.flights import Flights
from rcp_mavlink.forwarding import Forwarding
from rcp_mavlink.hub import Hub
from rcp_mavlink.imaging import Imaging
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.logs import Logs
from rcp_mavlink.missions import Missions
from rcp_mavlink.motion import Motion
from rcp_mavlink.parameter_defaults import ParameterDefaults
from rcp_mavlink.parameter_resources import ParameterResources
from rcp_mavlink.parameter_transfer import ParameterTransfer
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.plan_transfer import PlanTransfer
from rcp_mavlink.plans import FENCE, MISSION, RALLY, Plans
from rcp_mavlink.restart import Restarts
from rcp_mavlink.setpoints import Setpoints
from rcp_mavlink.terrain import Terrain
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Actions"]

_FIRST_POSITION = 3.0  # s
_ALLOWED_BLIND = ("action/land", "action/rtl", "action/return_home")

Verb = Callable[[Any, Progress], Awaitable[Any]]


class Actions:
    """The actions and services of one vehicle; `end_writes` ends whatever is held by writes."""

    def __init__(
        self,
        hub: Hub,
        vehicle: Vehicle,
        commands: Commands,
        intervals: Intervals,
        motion: Motion,
        setpoints: Setpoints,
        *,
        parameters: Parameters,
        parameter_resources: ParameterResources,
        described: Described,
        plans: Plans,
        flights: Flights,
        equipment: Equipment,
        terrain: Terrain,
        files: Files,
        forwarding: Forwarding,
        arming_block: ArmingBlock,
        restarts: Restarts,
        end_writes: Callable[[], None],
    ) -> None:
        self._vehicle, self._motion, self._plans = vehicle, motion, plans
        self._setpoints, self._end_writes = setpoints, end_writes
        missions, logs = Missions(vehicle, commands, plans, motion), Logs(hub, vehicle)
        calibration = Calibration(vehicle, commands, intervals, motion, parameters, arming_block)
        transfer = ParameterTransfer(
            vehicle, parameters, commands, described, restarts.reboot,
            parameter_resources.check_latched,
        )  # fmt: skip
        plan_files = PlanTransfer(vehicle, plans)
        direct = DirectCommands(hub.dialect.module, commands, hub.config.commands)
        leading = {**flights.verbs(), **equipment.leading(), "action/mission/run": missions.run}
        self._verbs: dict[str, Verb] = {
            "action/arm": motion.arm,
            "action/disarm": motion.disarm,
            "action/set_mode": self._set_mode,
            **{name: self._ending(name, verb) for name, verb in leading.items()},
            **missions.verbs(),
            **terrain.verbs(),
            **equipment.verbs(),
            "action/mission/resume": self._seen_to_move(missions.resume),
            **Imaging(hub, vehicle, commands, intervals, files).verbs(),
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
            **parameter_resources.verbs(),
            "service/param/export": transfer.export,
            "service/param/compare": transfer.compare,
            "action/param/load": transfer.load,
            "action/param/reset": transfer.reset,
            **ParameterDefaults(files).verbs(),
            "service/plan/export": plan_files.export,
            "action/plan/load": plan_files.load,
            "service/command": direct.send,
            "service/commands": direct.list,
            "service/reboot": lambda _, __: restarts.reboot(),
            "service/reset_system": restarts.reset,
            "service/enable": motion.arm,
            "service/disable": motion.disarm,
            "service/mavlink/ask": forwarding.ask,
        }

    async def run(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or service.

        :raises UnsupportedOperation: there is none of this name.
        """
        verb = self._verbs.get(name)
        if verb is None:
            raise UnsupportedOperation(f"'{name}' cannot be executed")
        self._vehicle.check()
        return await verb(value, progress)

    async def _upload(
        self, kind: int, items: m.Items, progress: Progress | None = None
    ) -> m.Uploaded:
        """Replace a plan; with progress if a refusal may leave a part of it."""
        told = None if progress is None else lambda part: progress(fraction=part)
        return m.Uploaded(await self._plans.upload(kind, items.items, told))

    async def _download(self, kind: int) -> m.Items:
        return m.Items(await self._plans.download(kind))

    async def _set_mode(self, given: m.SetMode, progress: Progress) -> m.SetMode:
        family = self._vehicle.family
        if given.mode.upper() == family.auto:
            self._motion.measurement.check()
        if family.px4 and given.mode.upper() == family.led != self._vehicle.mode:
            await self._setpoints.offboard()
        return await self._motion.set_mode(given, progress)

    def _ending(self, name: str, verb: Verb) -> Verb:
        """Wrap a command so that it ends the active set-points."""
        verb = verb if name in _ALLOWED_BLIND else self._seen_to_move(verb)

        async def run(given: Any, progress: Progress) -> Any:
            self._end_writes()
            return await verb(given, progress)

        return run

    def _seen_to_move(self, verb: Verb) -> Verb:
        """Refuse motion while the position is too old to observe it."""
        measurement = self._motion.measurement

        async def run(given: Any, progress: Progress) -> Any:
            if math.isinf(measurement.position_age):  # it may just have been requested
                await self._vehicle.until(lambda: not measurement.stale(), _FIRST_POSITION)
            measurement.check()
            return await verb(given, progress)

        return run
