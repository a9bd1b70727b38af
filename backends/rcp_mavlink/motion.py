"""Arming, modes and coming to rest: done when telemetry shows it, and not when it is acknowledged."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from rcp_kernel.errors import (
    DeviceRejected,
    DeviceTimeout,
    InvalidValue,
    NotImplementedByRobot,
    RcpError,
)
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Motion"]

_FORCE = 21196.0
_SETTLE = 3.0  # s for the telemetry to show what was accepted
_FEEDBACK = 0.25  # s
_AT_REST = 0.35  # m/s
_STOPPING = 15.0  # s in which it has come to rest
_HOLDING = 3.0  # s for a hold to be accepted after a cancel


class Motion:
    """What one vehicle is told to be: armed, in a mode, at rest."""

    def __init__(self, vehicle: Vehicle, commands: Commands) -> None:
        self._vehicle, self._commands = vehicle, commands
        self.parting: set[asyncio.Future[Any]] = set()
        """What cancelled commands still do."""

    # Arming and modes

    async def arm(self, given: m.Arm | None, progress: Progress) -> m.Armed:
        """Start the motors."""
        try:
            await self._arm(on=True, force=given is not None and given.force)
        except asyncio.CancelledError:
            await self.shielded(lambda: self._arm(on=False, force=False))
            raise
        return m.Armed(self._vehicle.armed, self._vehicle.mode)

    async def disarm(self, given: m.Arm | None, progress: Progress) -> m.Armed:
        """Stop the motors."""
        await self._arm(on=False, force=given is not None and given.force)
        return m.Armed(self._vehicle.armed, self._vehicle.mode)

    async def _arm(self, *, on: bool, force: bool) -> None:
        what = "arm" if on else "disarm"
        params = (float(on), _FORCE if force else 0.0, 0.0, 0.0)
        await self._commands.send(Command(400, params), what)
        await self.seen(lambda: self._vehicle.armed == on, what)

    async def set_mode(self, given: m.SetMode, progress: Progress) -> m.SetMode:
        """Change the flight mode."""
        name = given.mode.upper()
        modes = self._vehicle.family.modes.values()
        if name not in modes:
            raise InvalidValue(
                f"the vehicle has no mode {given.mode}",
                remedy=f"Its modes: {', '.join(modes)}.",
                details={"pointer": "/mode"},
            )
        await self.to_mode(name)
        return m.SetMode(self._vehicle.mode)

    async def to_mode(self, name: str, *, surely: bool = False) -> None:
        """Bring the vehicle into a mode of its family; `surely` also if it seems to be in it."""
        family = self._vehicle.family
        number = family.number(name)
        if number is None:
            raise NotImplementedByRobot(f"a {family.kind} has no mode {name or 'for that'}")
        if self._vehicle.mode_number == number and not surely:
            return
        params = (1.0, float(number), 0.0, 0.0)
        if family.px4:
            params = (1.0, float(number >> 16 & 0xFF), float(number >> 24 & 0xFF), 0.0)
        await self._commands.send(Command(176, params), f"mode {name}")
        await self.seen(lambda: self._vehicle.mode_number == number, f"mode {name}")

    async def seen(self, holds: Callable[[], bool], what: str) -> None:
        """Wait for the telemetry to show what was accepted.

        :raises DeviceTimeout: it does not.
        """
        if not holds():  # a heartbeat comes once a second, and sooner if it is asked for
            with suppress(DeviceRejected, DeviceTimeout):
                await self._commands.send(Command(512), "request of HEARTBEAT")
        if not await self._vehicle.until(holds, _SETTLE):
            raise DeviceTimeout(f"{what}: accepted, but the vehicle does not show it")

    async def follow(self, tell: Callable[[], bool], what: str, stays: Callable[[], bool]) -> None:
        """Wait for `tell`, which reports, and see that the vehicle stays at it.

        :raises DeviceRejected: it does something else, with what it said meanwhile.
        """
        began = time.monotonic()
        told, done = 0.0, False

        def look() -> bool:
            nonlocal told, done
            if (now := time.monotonic()) - told >= _FEEDBACK:
                told = now
                done = tell()
            else:
                done = False
            return done or not stays()

        await self._vehicle.until(look)
        if done or tell():
            return
        reasons = self._vehicle.texts_since(began, severity=4)
        said = f": {'; '.join(reasons[-3:])}" if reasons else ""
        raise DeviceRejected(
            f"{what}: the vehicle left it for mode {self._vehicle.mode}{said}",
            details={"mode": self._vehicle.mode, "texts": reasons},
        )

    # Coming to rest

    @property
    def rests(self) -> bool:
        """Whether it does not move, or circles where it was told to."""
        vehicle, fix = self._vehicle, self._vehicle.fix
        if not vehicle.armed or vehicle.landed is True:
            return True
        if vehicle.family.circles and vehicle.mode == vehicle.family.hold:
            return True
        return fix is not None and fix.speed < _AT_REST

    async def hold(self) -> None:
        """Come to rest where it is and stay."""
        vehicle = self._vehicle
        if vehicle.armed and vehicle.landed is not True:
            await self.to_mode(vehicle.family.hold, surely=True)

    async def halt(self, policy: str) -> None:
        """Bring it to rest, the way the e-stop's policy says; return when that is seen."""
        vehicle = self._vehicle
        if not vehicle.armed:
            return
        if policy == "disarm" or vehicle.landed is True:
            await self._arm(on=False, force=policy == "disarm")
            return
        if policy == "land" and vehicle.family.land:
            await self.to_mode(vehicle.family.land, surely=True)
            return
        await self.hold()
        if not await vehicle.until(lambda: self.rests, _STOPPING):
            raise DeviceTimeout("the vehicle was told to hold and still moves")

    async def shielded(self, do: Callable[[], Awaitable[Any]]) -> None:
        """Do it although the command that asks is being cancelled."""
        task = asyncio.ensure_future(do())
        self.parting.add(task)
        task.add_done_callback(self.parting.discard)
        with suppress(RcpError, TimeoutError):
            async with asyncio.timeout(_HOLDING):
                await asyncio.shield(task)
