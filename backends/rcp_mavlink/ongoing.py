"""Something beside the flight that goes on by itself: stopped until it is seen to be over."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, PreconditionFailed, RcpError
from rcp_kernel.spi import MotionState
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.motion import Motion
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Ongoing"]

_AGAIN = 0.2  # s between repetitions of a stop
_OVER = 2.5  # s for telemetry to show that it has stopped
_RECENT = 1.0  # s


class Ongoing:
    """What one command has set in motion; a `message` of the vehicle shows it."""

    def __init__(self, vehicle: Vehicle, commands: Commands, motion: Motion, message: str) -> None:
        self._vehicle, self._commands, self._motion = vehicle, commands, motion
        self._message = message
        self._what = ""
        self._stop: Command | None = None
        """What stops it; None if nothing goes on."""
        self._is_over: Callable[[float], bool] = lambda _: True
        self._release: Callable[[], None] = lambda: None
        self._ended_at: float | None = None
        """When it was first commanded to stop."""
        self._sent = -math.inf

    def check(self) -> None:
        """Refuse another one as long as this one goes on.

        :raises PreconditionFailed: it has not been seen to stop yet.
        """
        if self.runs():
            raise PreconditionFailed(
                f"{self._what}: it has not been seen to stop yet", remedy="Try again later."
            )

    async def begin(
        self,
        command: Command,
        what: str,
        *,
        stop: Command,
        is_over: Callable[[float], bool],
        release: Callable[[], None],
    ) -> None:
        """Send the command; `is_over` tells whether it has ended since a time, `release` ends this.

        :raises DeviceRejected: the vehicle refuses it.
        """
        self._what, self._stop, self._is_over, self._release = what, stop, is_over, release
        self._ended_at, self._sent = None, -math.inf
        try:
            await self._commands.send(command, what)
        except DeviceRejected:
            self.forget()
            raise

    def forget(self) -> None:
        """Count it as over."""
        if self._stop is not None:
            self._stop = None
            self._release()

    def runs(self) -> bool:
        """Tell whether it goes on, as far as is known; a stop alone does not end that."""
        if self._stop is not None and self._ended_at is not None and self._is_over(self._ended_at):
            self.forget()
        return self._stop is not None

    def state(self) -> MotionState | None:
        """Return that it moves; None if nothing does."""
        if not self.runs():
            return None
        age = time.monotonic() - self._vehicle.received_at.get(self._message, -math.inf)
        if self._vehicle.lost or age > _RECENT:
            return MotionState(None, f"{self._what}: not seen to have stopped")
        return MotionState(False, f"{self._what}: moves")

    def end(self) -> None:
        """Send the stop at once, without waiting for a reply; again only after a while."""
        now = time.monotonic()
        if not self.runs() or self._stop is None or now - self._sent < _AGAIN:
            return
        self._ended_at = now if self._ended_at is None else self._ended_at
        self._commands.send_once(self._stop, urgent=True)
        self._sent = now

    def keep_ending(self) -> None:
        """Send the stop again if it was sent before: it may have been lost."""
        if self._ended_at is not None:
            self.end()

    async def fail(self, error: BaseException) -> None:
        """Stop it because its action has failed or is cancelled.

        :raises RcpError: the stop is not confirmed, so that it may go on.
        """
        if not self.runs():
            return
        try:
            await self._motion.shielded(self._stopped)
        except RcpError:
            if isinstance(error, asyncio.CancelledError | DeviceRejected):
                raise  # neither says that it may still move

    async def _stopped(self) -> None:
        """Stop it and wait until it has.

        :raises DeviceTimeout: telemetry does not show that.
        """
        stop, what = self._stop, self._what
        if stop is None:
            return
        if self._vehicle.lost:  # the uplink may work although the downlink does not
            self.end()
        self._ended_at = self._ended_at or time.monotonic()
        await self._commands.send(stop, f"{what}: stop", urgent=True)
        if not await self._vehicle.until(lambda: not self.runs(), _OVER):
            raise DeviceTimeout(f"{what}: it was not seen to stop")
