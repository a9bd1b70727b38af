"""Arming, blocked on board while somebody moves the sticks of a remote control, which could arm it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress

from rcp_kernel.errors import DeviceRejected, PreconditionFailed, RcpError
from rcp_mavlink.arming_sticks import ArmingSticks
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.motion import Motion
from rcp_mavlink.vehicle import Vehicle

__all__ = ["ArmingBlock"]

_CALIBRATION, _CHECKS = 241, 401
_BLOCK = Command(_CALIBRATION, (0.0, 0.0, 0.0, 1.0))
_RELEASE = Command(_CALIBRATION)
_WHAT = "calibrate radio"
_REASON = "RC calibrating"
_UNSUPPORTED = "unsupported"
"""The answer of an ArduPilot that has changed nothing but its flag."""
_ATTEMPTS, _ANSWER = 3, 1.0  # requests for the reasons against arming, and s for each
_AT_ONCE, _LATER = 1.7, 30.0  # s for the sticks to be let go, at the end and later


class ArmingBlock:
    """The flag of one ArduPilot that refuses to arm: by sticks, switches and ground stations.

    The vehicle keeps it until it is released or restarts, also if the gateway is gone meanwhile.
    """

    def __init__(
        self, vehicle: Vehicle, commands: Commands, motion: Motion, sticks: ArmingSticks
    ) -> None:
        self._vehicle, self._commands, self._motion = vehicle, commands, motion
        self._sticks = sticks
        self._held = False
        self._owed = False
        """Whether the flag may be set on board although nobody holds it."""
        self._releasing: asyncio.Task[None] | None = None

    @property
    def is_owed(self) -> bool:
        """Whether the vehicle may go on refusing to arm, until `keep_releasing` has released it."""
        return self._owed

    @asynccontextmanager
    async def held(self) -> AsyncGenerator[None]:
        """Block arming while entered, and release it afterwards, also when it is cancelled.

        Not while the sticks are where they would arm it at once: see `is_owed`.

        :raises PreconditionFailed: the vehicle does not say that it cannot be armed.
        """
        self._held = True
        try:
            await self.renew()
            yield
        finally:
            self._held = False
            with suppress(RcpError):  # `keep_releasing` goes on
                await self._motion.shielded(lambda: self._release(_AT_ONCE))

    async def renew(self) -> None:
        """Set the flag, and wait until the vehicle names it as a reason against arming.

        :raises PreconditionFailed: it does not.
        """
        self._owed = True
        await self._flag(_BLOCK)
        for _ in range(_ATTEMPTS):
            since = time.monotonic()
            self._commands.send_once(Command(_CHECKS))
            if await self._vehicle.until(lambda at=since: self._is_named(at), _ANSWER):
                return
        raise PreconditionFailed(
            f"{_WHAT}: the vehicle does not confirm that its sticks cannot arm it; nothing was written",
            remedy=f"Clear its other reasons against arming (sensor/prearm) until it says '{_REASON}', or use a newer firmware.",
        )

    def keep_releasing(self) -> None:
        """Release what could not be released: the link was lost, or the sticks were not let go."""
        vehicle, task = self._vehicle, self._releasing
        waits = self._held or vehicle.lost or vehicle.armed  # an armed one refuses it
        if self._owed and not waits and (task is None or task.done()):
            self._releasing = asyncio.get_running_loop().create_task(self._release_quietly())

    def close(self) -> None:
        """End what is under way."""
        if self._releasing is not None:
            self._releasing.cancel()

    def _is_named(self, since: float) -> bool:
        return any(_REASON in text for text in self._vehicle.texts_since(since))

    async def _release_quietly(self) -> None:
        with suppress(RcpError):
            await self._release(_LATER)

    async def _release(self, seconds: float) -> None:
        """Release it once the sticks are let go, if that is within some seconds."""
        if not self._owed or self._vehicle.armed or not await self._sticks.let_go(seconds):
            return
        if not self._held:  # it may have been blocked again meanwhile
            await self._flag(_RELEASE)
            self._owed = self._held

    async def _flag(self, command: Command) -> None:
        try:
            await self._commands.send(command, _WHAT)
        except DeviceRejected as error:
            if (error.details or {}).get("result") != _UNSUPPORTED:
                raise
