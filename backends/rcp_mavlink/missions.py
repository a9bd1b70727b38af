"""Missions as actions: uploaded, flown to their end, paused and resumed."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Any

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, PreconditionFailed
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.motion import Motion
from rcp_mavlink.plans import MISSION, Plans
from rcp_mavlink.restart import Restart, one_boot
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Missions"]

_ACTIVE, _PAUSED, _COMPLETE = 3, 4, 5
_STARTING = 5.0  # s
_SET_CURRENT = 224
_PAUSING = 15.0  # s
_ENDING = 1.5  # s for the state of a mission to follow the mode


class Missions:
    """The mission of one vehicle."""

    def __init__(self, vehicle: Vehicle, commands: Commands, plans: Plans, motion: Motion) -> None:
        self._vehicle, self._commands = vehicle, commands
        self._plans, self._motion = plans, motion

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path except the run."""
        return {
            "action/mission/upload": self.upload,
            "action/mission/pause": self.pause,
            "action/mission/resume": self.resume,
            "service/mission/set_current": self.set_current,
        }

    async def upload(self, given: m.Items, progress: Progress) -> m.Uploaded:
        """Replace the mission."""
        count = await self._plans.upload(MISSION, given.items, lambda part: progress(fraction=part))
        return m.Uploaded(count)

    def _now(self) -> dict[str, Any]:
        frame = self._vehicle.latest.get("MISSION_CURRENT")
        return {"seq": 0, "total": 0, "mission_state": 0} if frame is None else frame.fields()

    async def run(self, _: None, progress: Progress) -> m.MissionProgress:
        """Fly the mission to its end."""
        if not self._vehicle.armed:
            raise PreconditionFailed("mission: the vehicle is not armed", remedy="Arm it first.")
        try:
            async with one_boot(self._vehicle, self._commands, "mission") as boot:
                await self._fly(progress, boot)
        except asyncio.CancelledError:
            await self._motion.shielded(self._motion.hold)
            raise
        return self._progress()

    async def _fly(self, progress: Progress, boot: Restart) -> None:
        vehicle, auto = self._vehicle, self._vehicle.family.auto
        measurement, flew = self._motion.measurement, vehicle.landed is False
        await self._motion.to_mode(auto)
        await self._commands.send(Command(300), "mission")
        since = time.monotonic()
        started = await vehicle.until(
            lambda: (
                self._now()["mission_state"] in (_ACTIVE, _COMPLETE)
                and vehicle.received_at["MISSION_CURRENT"] > since
            ),
            _STARTING,
        )
        if not started:
            raise DeviceTimeout("mission: accepted, but the vehicle does not start it")

        def report() -> bool:
            nonlocal flew
            flew = flew or vehicle.landed is False
            now = self._now()
            total = now.get("total", 0)
            part = now["seq"] / total if 0 < total < 65535 else 0.0
            progress(self._progress(), fraction=min(1.0, part))
            over = measurement.standing and measurement.disarmed
            return now["mission_state"] == _COMPLETE or (flew and over)

        def stays() -> bool:
            return vehicle.mode == auto and not boot.began_again

        try:
            await self._motion.follow(report, "mission", stays=stays)
        except DeviceRejected:
            if boot.began_again or not await self._is_finished():
                raise

    def _progress(self) -> m.MissionProgress:
        now = self._now()
        # PX4 counts from 0; the first item of an ArduPilot is home.
        item = now["seq"] + 1 if self._vehicle.family.px4 and now.get("total") else now["seq"]
        return m.MissionProgress(item, now.get("total", 0), self._vehicle.mode)

    async def _is_finished(self) -> bool:
        """Return whether it has left the mode at the end of its mission, as a PX4 and a rover always do."""
        vehicle, now = self._vehicle, self._now()
        if vehicle.family.px4:
            if vehicle.mode != vehicle.family.hold:
                return False
        elif now["seq"] < now.get("total", 0):  # an ArduPilot stays at the last item
            return False

        def is_complete() -> bool:
            holds = not vehicle.family.px4 or vehicle.mode == vehicle.family.hold
            return holds and self._now()["mission_state"] == _COMPLETE

        return await vehicle.until(is_complete, _ENDING)

    async def pause(self, _: None, progress: Progress) -> m.MissionProgress:
        """Stop at the current position, to resume later."""
        vehicle = self._vehicle
        if vehicle.mode != vehicle.family.auto:
            raise PreconditionFailed(f"mission: none is running, the mode is {vehicle.mode}")
        if vehicle.family.px4:  # it pauses by leaving the mode, and remembers its item
            await self._motion.to_mode(vehicle.family.hold, urgent=True)
        else:
            await self._commands.send(Command(193), "pause", urgent=True)
        px4 = vehicle.family.px4
        paused = await vehicle.until(
            lambda: (px4 or self._now()["mission_state"] == _PAUSED) and self._motion.rests,
            _PAUSING,
        )
        if not paused:
            raise DeviceTimeout("pause: accepted, but the vehicle still moves")
        return self._progress()

    async def resume(self, _: None, progress: Progress) -> m.MissionProgress:
        """Resume a paused mission."""
        if self._vehicle.family.px4:
            await self._motion.to_mode(self._vehicle.family.auto)
        else:
            await self._commands.send(Command(193, (1.0, 0.0, 0.0, 0.0)), "resume")
        if not await self._vehicle.until(
            lambda: self._now()["mission_state"] == _ACTIVE, _STARTING
        ):
            raise DeviceTimeout("resume: accepted, but the vehicle does not continue")
        return self._progress()

    async def set_current(self, given: m.SetItem, _: Progress) -> m.MissionProgress:
        """Set the item that is flown next; a running mission goes there at once.

        :raises DeviceTimeout: the vehicle does not report the item.
        """
        vehicle = self._vehicle
        # The first item of an ArduPilot is home, which is not counted here.
        number = given.item - 1 if vehicle.family.px4 else given.item
        command = Command(_SET_CURRENT, (float(number), 0.0, 0.0, 0.0))
        await self._commands.send(command, "set_current")
        if not await vehicle.until(lambda: self._now()["seq"] == number, _STARTING):
            raise DeviceTimeout("set_current: accepted, but the vehicle does not report the item")
        return self._progress()
