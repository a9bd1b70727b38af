"""The winch: line let out and wound in, followed by what the winch reports."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, PreconditionFailed, RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.motion import Motion
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Winches"]

_WINCH = 42600
_LENGTH, _RATE = 1.0, 2.0
_STATUS = "WINCH_STATUS"
_RETRACTED, _WINDS = 2, 4  # bits of MAV_WINCH_STATUS_FLAG
_REPORTS = 5.0  # Hz
_FIRST, _STARTING = 1.0, 3.0  # s for a first report, and for the line to move
_NEAR = 0.1  # m

Line = Annotated[float, Meta(ge=-100, le=100, extra_json_schema={"unit": "m"})]


class WinchCommand(Struct, frozen=True, forbid_unknown_fields=True):
    """Line to let out; negative winds it in."""

    length: Line
    speed: Annotated[float, Meta(gt=0, le=5, extra_json_schema={"unit": "m/s"})] = 0.5
    winch: Annotated[int, Meta(ge=1, le=6, extra_json_schema={"unit": "1"})] = 1


class WinchState(Struct, frozen=True):
    """The line that is out."""

    length: Annotated[float, Meta(extra_json_schema={"unit": "m"})]


class Winches:
    """The winch of one vehicle."""

    def __init__(
        self, vehicle: Vehicle, commands: Commands, intervals: Intervals, motion: Motion
    ) -> None:
        self._vehicle, self._commands = vehicle, commands
        self._intervals, self._motion = intervals, motion
        self._winding = 0
        """The number of the winch that is commanded; 0 if none."""

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {"action/winch": self.wind}

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="action/winch", description="Let out line or wind it in; completes when the winch has stopped at that length. A cancel stops it.", input=WinchCommand, output=WinchState, feedback=WinchState, examples=({"length": 2.0}, {"length": -2.0}), timeout=300, max_age=30.0)
        ]  # fmt: skip

    async def wind(self, given: WinchCommand, progress: Progress) -> WinchState:
        """Wind by a length.

        :raises PreconditionFailed: there is no winch that reports its line.
        :raises DeviceTimeout: the line does not move.
        :raises DeviceRejected: the winch stops at another length.
        """
        release = self._intervals.want(_STATUS, _REPORTS)
        try:
            before = await self._line()
            wanted = before + given.length
            self._winding = given.winch
            params = (float(given.winch), _LENGTH, given.length, given.speed)
            await self._commands.send(Command(_WINCH, params), "winch")
            progress(WinchState(before), fraction=0.0)  # it moves from here on
            await self._follow(before, wanted, progress)
        except BaseException as error:
            if isinstance(error, asyncio.CancelledError | DeviceTimeout):
                with suppress(RcpError):
                    await self._motion.shielded(self._stop)
            raise
        finally:
            release()
            self._winding = 0
        return WinchState(self._length)

    async def _line(self) -> float:
        since = time.monotonic()
        received = self._vehicle.received_at
        if not await self._vehicle.until(lambda: received.get(_STATUS, 0.0) >= since, _FIRST):
            raise PreconditionFailed(
                "winch: the vehicle reports no winch",
                remedy="Check that it has one and sends WINCH_STATUS: see sensor/winch.",
            )
        return self._length

    @property
    def _length(self) -> float:
        return self._vehicle.latest[_STATUS].fields()["line_length"]

    async def _follow(self, before: float, wanted: float, progress: Progress) -> None:
        began, moved, done = time.monotonic(), False, False

        def over() -> bool:
            nonlocal moved, done
            f = self._vehicle.latest[_STATUS].fields()
            length, winds = f["line_length"], bool(f["status"] & _WINDS)
            moved = moved or winds or abs(length - before) > _NEAR
            in_ = wanted < before and bool(f["status"] & _RETRACTED)
            done = not winds and (abs(length - wanted) <= _NEAR or in_)
            progress(WinchState(length), fraction=_part(before, wanted, length))
            late = not moved and time.monotonic() - began > _STARTING
            return done or late or (moved and not winds)

        await self._vehicle.until(over)
        if done:
            return
        if not moved:
            raise DeviceTimeout("winch: accepted, but the line does not move")
        raise DeviceRejected(f"winch: it stopped at {self._length:.1f} m, not at {wanted:.1f} m")

    def _stopping(self) -> Command:
        return Command(_WINCH, (float(self._winding), _RATE, 0.0, 0.0))

    async def _stop(self) -> None:
        await self._commands.send(self._stopping(), "winch: stop")

    def end(self) -> None:
        """Stop the winch at once, for an e-stop."""
        if self._winding:
            self._commands.send_once(self._stopping())


def _part(before: float, wanted: float, now: float) -> float:
    whole = abs(wanted - before)
    return min(1.0, abs(now - before) / whole) if whole else 1.0
