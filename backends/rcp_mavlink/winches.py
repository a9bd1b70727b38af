"""The winch: line let out and wound in, followed by what the winch reports."""

from __future__ import annotations

import math
import time
from collections.abc import Awaitable, Callable
from contextlib import ExitStack
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, PreconditionFailed
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.frames import Frame
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.motion import Motion
from rcp_mavlink.ongoing import Ongoing
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Winches"]

_WINCH = 42600
_LENGTH, _RATE = 1.0, 2.0
_STATUS = "WINCH_STATUS"
_RETRACTED, _WINDS = 2, 4  # bits of MAV_WINCH_STATUS_FLAG
_REPORTS = 5.0  # Hz
_FIRST, _STARTING = 1.0, 3.0  # s for a first report, and for the line to move
_NEAR = 0.1  # m
_STILL = 1.0  # s for which its reports show no motion until it counts as stopped
_CREEP, _JITTER = 0.01, 0.02  # m/s and m below which a line does not move

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
        self._vehicle, self._intervals = vehicle, intervals
        self.ongoing = Ongoing(vehicle, commands, motion, _STATUS)
        """The winding that is commanded and not known to be over."""
        self._reported = self._still_since = -math.inf
        """When it last reported, and since when all of its reports show no motion."""
        self._still_at = math.nan

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

        :raises PreconditionFailed: no winch reports its line, or it is still being stopped.
        :raises DeviceTimeout: the line does not move.
        :raises DeviceRejected: the winch stops at another length.
        """
        self.ongoing.check()
        with ExitStack() as watching:
            watching.callback(self._intervals.want(_STATUS, _REPORTS))
            watching.enter_context(self._vehicle.listening(_STATUS, self._report))
            before = await self._line()
            release = watching.pop_all().close  # as long as it may wind
        number = float(given.winch)
        self._still_since = time.monotonic()
        try:
            await self.ongoing.begin(
                Command(_WINCH, (number, _LENGTH, given.length, given.speed)),
                "winch",
                stop=Command(_WINCH, (number, _RATE, 0.0, 0.0)),
                is_over=self._stands,
                release=release,
            )
            progress(WinchState(before), fraction=0.0)  # it moves from here on
            await self._follow(before, before + given.length, progress)
        except BaseException as error:
            await self.ongoing.fail(error)
            raise
        self.ongoing.forget()
        return WinchState(self._length)

    def _report(self, frame: Frame) -> None:
        """Notice whether it moves; the winch by PWM of ArduPilot never sets the bit for that."""
        f, now = frame.fields(), time.monotonic()
        moves = bool(f["status"] & _WINDS) or abs(f["speed"]) > _CREEP
        if moves or not abs(f["line_length"] - self._still_at) <= _JITTER:
            self._still_at, self._still_since = f["line_length"], now
        elif now - self._reported > _STILL:  # it may have moved in between
            self._still_since = now
        self._reported = now

    def _stands(self, since: float = -math.inf) -> bool:
        return self._reported - max(self._still_since, since) >= _STILL

    async def _line(self) -> float:
        since = time.monotonic()
        received = self._vehicle.received_at
        if not await self._vehicle.until(
            lambda: received.get(_STATUS, float("-inf")) >= since, _FIRST
        ):
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
            length, stands = f["line_length"], self._stands()
            winds = bool(f["status"] & _WINDS) or abs(f["speed"]) > _CREEP
            moved = moved or winds or abs(length - before) > _NEAR
            in_ = wanted < before and bool(f["status"] & _RETRACTED)
            done = stands and (abs(length - wanted) <= _NEAR or in_)
            progress(WinchState(length), fraction=_part(before, wanted, length))
            late = not moved and time.monotonic() - began > _STARTING
            return done or late or (moved and stands)

        await self._vehicle.until(over)
        if done:
            return
        if not moved:
            raise DeviceTimeout("winch: accepted, but the line does not move")
        raise DeviceRejected(f"winch: it stopped at {self._length:.1f} m, not at {wanted:.1f} m")


def _part(before: float, wanted: float, now: float) -> float:
    whole = abs(wanted - before)
    return min(1.0, abs(now - before) / whole) if whole else 1.0
