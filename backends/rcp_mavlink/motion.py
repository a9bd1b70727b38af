"""Arming, modes and coming to rest: complete when telemetry confirms the state."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Generator
from contextlib import contextmanager, suppress
from typing import Any

from rcp_kernel.errors import (
    DeviceRejected,
    DeviceTimeout,
    EstopActive,
    InvalidValue,
    NotImplementedByRobot,
    RcpError,
)
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands, mode_command
from rcp_mavlink.measurement import AT_REST, Measurement
from rcp_mavlink.stop import PAUSE_PX4
from rcp_mavlink.vehicle import Vehicle
from rcp_protocol.timeouts import timeout

__all__ = ["Motion", "unanswered"]

_FORCE = 21196.0
_SETTLE = 3.0  # s for telemetry to show what was accepted
_FEEDBACK = 0.25  # s
_UNANSWERED = 0.3  # s
_HOLDING = 3.0  # s for a hold to be accepted after a cancellation
_WAY_DOWN = ("land", "return")
"""Commands that do not need a position: holding would be no better."""


class Motion:
    """Commands one vehicle to arm, change its mode or come to rest."""

    def __init__(self, vehicle: Vehicle, commands: Commands, measurement: Measurement) -> None:
        self._vehicle, self._commands = vehicle, commands
        self.measurement = measurement
        self.parting: set[asyncio.Future[Any]] = set()
        """Stops still in progress for cancelled commands."""

    # Arming and modes

    async def arm(self, given: m.Arm | None, progress: Progress) -> m.Armed:
        """Start the motors."""
        try:
            await self._arm(progress, on=True, force=given is not None and given.force)
        except asyncio.CancelledError:
            await self.shielded(lambda: self._arm(_ignore_progress, on=False, force=False))
            raise
        return m.Armed(self._vehicle.armed, self._vehicle.mode)

    async def disarm(self, given: m.Arm | None, progress: Progress) -> m.Armed:
        """Stop the motors."""
        await self._arm(progress, on=False, force=given is not None and given.force)
        return m.Armed(self._vehicle.armed, self._vehicle.mode)

    async def _arm(self, progress: Progress, *, on: bool, force: bool) -> None:
        what = "arm" if on else "disarm"
        params = (float(on), _FORCE if force else 0.0, 0.0, 0.0)
        with unanswered(progress):
            await self._commands.send(Command(400, params), what)
        progress()  # the motors may turn from here on, so a lost link no longer means a refusal
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
        # Sent even if it seems to be in effect: the last heartbeat may be older than another's change.
        await self.to_mode(name, surely=True, progress=progress)
        return m.SetMode(self._vehicle.mode)

    async def to_mode(
        self,
        name: str,
        *,
        surely: bool = False,
        progress: Progress | None = None,
        urgent: bool = False,
    ) -> None:
        """Change to a mode of its family; `surely` sends it even if it seems to be in effect.

        An urgent one, to come to rest, has room on a full link.
        """
        family = self._vehicle.family
        command, number = mode_command(family, name), family.number(name)
        if self._vehicle.mode_number == number and not surely:
            return
        on_progress = _ignore_progress if progress is None else progress
        with unanswered(on_progress):
            await self._commands.send(command, f"mode {name}", urgent=urgent)
        on_progress()
        await self.seen(lambda: self._vehicle.mode_number == number, f"mode {name}")

    async def seen(self, holds: Callable[[], bool], what: str) -> None:
        """Wait for telemetry to show what was accepted.

        :raises DeviceTimeout: it does not.
        """
        if not holds():  # heartbeats arrive once a second; a request brings one sooner
            with suppress(DeviceRejected, DeviceTimeout):
                await self._commands.send(Command(512), "request for HEARTBEAT")
        if not await self._vehicle.until(holds, _SETTLE):
            raise DeviceTimeout(f"{what}: accepted, but telemetry does not confirm it")

    async def follow(
        self, report: Callable[[], bool], what: str, stays: Callable[[], bool]
    ) -> None:
        """Wait until `report` returns True, while `stays` holds.

        :raises DeviceRejected: the vehicle does something else; includes its status texts.
        :raises DeviceTimeout: no position for longer than the limit.
        """
        began = time.monotonic()
        reported, done = -math.inf, False

        def poll() -> bool:
            nonlocal reported, done
            if (now := time.monotonic()) - reported >= _FEEDBACK:
                reported = now
                done = report()
            else:
                done = False
            return done or not stays()

        while not await self._vehicle.until(poll, _FEEDBACK):
            if what not in _WAY_DOWN and self.measurement.blind:
                await self._blind(what)
        if done or report():
            return
        reasons = self._vehicle.texts_since(began, severity=4)
        reason = f": {'; '.join(reasons[-3:])}" if reasons else ""
        raise DeviceRejected(
            f"{what}: the vehicle changed to mode {self._vehicle.mode}{reason}",
            details={"mode": self._vehicle.mode, "texts": reasons},
        )

    async def _blind(self, what: str) -> None:
        """Command a hold when position feedback is lost.

        :raises DeviceTimeout: always.
        """
        why = self.measurement.unknown()
        await self.shielded(self.hold)
        raise DeviceTimeout(f"{what}: {why}; the vehicle was commanded to hold")

    # Coming to rest

    @property
    def rests(self) -> bool:
        """Whether it is seen to be still, or to circle in a mode meant for it."""
        vehicle, measurement = self._vehicle, self.measurement
        if measurement.disarmed or measurement.standing:
            return True
        if vehicle.family.circles and vehicle.mode == vehicle.family.hold:
            return measurement.has_heartbeat
        speed = measurement.speed
        return speed is not None and speed < AT_REST

    async def hold(self) -> None:
        """Hold the position, in the first suitable mode that the vehicle accepts."""
        vehicle = self._vehicle
        if self.measurement.disarmed or self.measurement.standing:
            return
        family, hovering = vehicle.family, vehicle.hovering
        modes = family.holding(hovering=hovering) + family.level(hovering=hovering)
        if not modes:
            raise NotImplementedByRobot(f"a {family.kind} has no holding mode")
        for mode in modes[:-1]:
            try:
                await self._hold_in(mode)
            except DeviceRejected:  # without a position, for example
                continue
            return
        await self._hold_in(modes[-1])

    async def _hold_in(self, mode: str) -> None:
        await self.to_mode(mode, surely=True, urgent=True)
        if self._vehicle.family.px4:
            self._commands.send_once(PAUSE_PX4, urgent=True)

    async def shielded(self, do: Callable[[], Awaitable[Any]]) -> None:
        """Finish a stop although the calling command is being cancelled.

        :raises RcpError: the stop failed: the cancellation has not reached the vehicle.
        """
        task = asyncio.ensure_future(do())
        self.parting.add(task)
        task.add_done_callback(self._parted)
        try:
            async with timeout(_HOLDING):
                await asyncio.shield(task)
        except EstopActive:
            return  # a stop is already under way
        except TimeoutError as error:
            if isinstance(error, DeviceTimeout):
                raise
            raise DeviceTimeout("the vehicle did not confirm that it holds") from None

    def _parted(self, task: asyncio.Future[Any]) -> None:
        self.parting.discard(task)
        if not task.cancelled():
            task.exception()  # a stop that outlived its caller: the caller has reported the failure


def _ignore_progress(feedback: Any = None, *, fraction: float | None = None) -> None:
    """Discard the progress of a command that is being cancelled."""


@contextmanager
def unanswered(progress: Callable[[], object]) -> Generator[None]:
    """Report progress if the vehicle has not responded for a while.

    It may have started to move by then; without progress, a lost link would count as a refusal.
    """

    def report() -> None:
        with suppress(RcpError):
            progress()

    timer = asyncio.get_running_loop().call_later(_UNANSWERED, report)
    try:
        yield
    finally:
        timer.cancel()
