"""The channels of a remote control, measured while somebody moves its sticks, and written to an ArduPilot."""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from contextlib import contextmanager

from rcp_kernel.errors import (
    AdapterUnavailable,
    Cancelled,
    DeviceRejected,
    PreconditionFailed,
    RcpError,
    UnsupportedOperation,
)
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.arming_block import ArmingBlock
from rcp_mavlink.frames import Frame
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.restart import Restart, watched
from rcp_mavlink.vehicle import Vehicle

__all__ = ["RadioCalibration"]

_CHANNELS = "RC_CHANNELS"
_RATE = 20.0  # Hz
_WAIT = 3.0  # s for the first message
_LOWEST, _HIGHEST = 800, 2200  # µs: ArduPilot takes no other pulses
_USED = 300  # µs by which a channel that is in use was moved at least
_FLYING = ("RCMAP_ROLL", "RCMAP_PITCH", "RCMAP_THROTTLE", "RCMAP_YAW")
_DRIVING = ("RCMAP_ROLL", "RCMAP_THROTTLE")
"""The sticks that have to be moved: a rover or boat has a steering and a throttle."""
_THROTTLE = "RCMAP_THROTTLE"
_REVERSED = "THR_MIN"
"""Negative: a plane with reverse thrust, whose throttle rests in the middle."""
_MIDDLE = (
    "Take the propellers off. Put all sticks in the middle, the throttle too, and execute"
    " service/calibrate/continue."
)
_ARMED = "calibrate radio: the vehicle was armed meanwhile, and still is"
_RESTARTED = (
    "calibrate radio: the vehicle restarted, so its sticks can arm it again; nothing was written"
)
_OWED = "the vehicle refuses to arm until its sticks are let go and the gateway reaches it"
_LET_GO = "Put its sticks in the middle; if the vehicle does not report them any more, execute service/reboot."
_DISARM = "Stand back, and execute action/disarm before you try again."
_ENDS = (
    "Move all sticks and switches to all their ends; until this is over the vehicle refuses to arm."
    " Then put the throttle down, the other sticks in the middle and all switches to their usual"
    " places, and execute service/calibrate/continue."
)


class RadioCalibration:
    """The remote control of one vehicle."""

    def __init__(
        self, vehicle: Vehicle, intervals: Intervals, parameters: Parameters, block: ArmingBlock
    ) -> None:
        self._vehicle, self._intervals, self._parameters = vehicle, intervals, parameters
        self._block = block
        self._going_on: asyncio.Event | None = None
        self._step = ""

    @property
    def waits(self) -> bool:
        """Whether it waits for somebody to go on."""
        return self._going_on is not None and not self._going_on.is_set()

    def proceed(self) -> m.Calibrating:
        """Go on to the next step; call it only while it waits."""
        if self._going_on is not None:
            self._going_on.set()
        return m.Calibrating("", self._step)

    async def run(self, progress: Progress) -> m.Calibrated:
        """Measure all channels, and write those that were moved; nothing is written before.

        The vehicle cannot be armed meanwhile.

        :raises UnsupportedOperation: the autopilot is a PX4.
        :raises AdapterUnavailable: no pulses of a remote control are reported.
        :raises PreconditionFailed: it does not confirm that it cannot be armed, or restarts.
        :raises DeviceRejected: a stick that flies the vehicle was not moved.
        :raises Cancelled: it was cancelled while the sticks would arm the vehicle.
        """
        if self._vehicle.family.px4:
            raise UnsupportedOperation(
                "calibrate radio: only for ArduPilot",
                remedy="Calibrate the remote control of a PX4 with QGroundControl.",
            )
        with self._pulses():
            await self._first()
            try:
                async with self._block.held():
                    done = await self._calibrated(progress)
            except asyncio.CancelledError:
                if not self._block.is_owed:
                    raise
                text = f"calibrate radio was cancelled; {_OWED}"
                raise Cancelled(text, remedy=_LET_GO) from None
            except RcpError as error:
                if self._block.is_owed:
                    error.message = f"{error.message}; {_OWED}"
                    error.remedy = f"{error.remedy} {_LET_GO}"
                raise
            return m.Calibrated("radio", [*done, _OWED] if self._block.is_owed else done)

    async def _calibrated(self, progress: Progress) -> list[str]:
        with watched(self._vehicle) as restart:
            await self._ask("middle", _MIDDLE, progress, 0.0, restart)
            middle = self._now()
            low, high = dict(middle), dict(middle)

            def take(frame: Frame) -> None:
                for channel, pulse in _pulses_of(frame).items():
                    low[channel] = min(low.get(channel, pulse), pulse)
                    high[channel] = max(high.get(channel, pulse), pulse)

            await self._block.renew()  # somebody else's calibration would have ended it
            with self._vehicle.listening(_CHANNELS, take):
                await self._ask("ends", _ENDS, progress, 0.4, restart)
        moved = [channel for channel in middle if high[channel] - low[channel] >= _USED]
        await self._parameters.complete.wait()
        self._check(moved)
        wanted = {
            channel: self._wanted(channel, low[channel], middle[channel], high[channel])
            for channel in moved
        }
        return await self._write(wanted)

    @contextmanager
    def _pulses(self) -> Generator[None]:
        release = self._intervals.want(_CHANNELS, _RATE)
        try:
            yield
        finally:
            release()
            self._going_on = None

    async def _first(self) -> None:
        received = self._vehicle.received_at
        since = received.get(_CHANNELS, float("-inf"))
        fresh = await self._vehicle.until(
            lambda: received.get(_CHANNELS, float("-inf")) > since, _WAIT
        )
        if not fresh or not self._now():
            raise AdapterUnavailable(
                "calibrate radio: the vehicle reports no pulses of a remote control",
                remedy="Switch the remote control on, and check that its receiver is bound.",
            )

    async def _ask(
        self, step: str, text: str, progress: Progress, part: float, restart: Restart
    ) -> None:
        """Wait until somebody says that it is done.

        :raises PreconditionFailed: the vehicle was armed meanwhile, or restarted and may be.
        """
        self._going_on, self._step = asyncio.Event(), step
        progress(m.Calibrating(text, step), fraction=part)
        going_on = self._going_on

        def is_over() -> bool:
            return going_on.is_set() or self._vehicle.armed or restart.done or restart.began_again

        while not going_on.is_set():
            await self._vehicle.until(is_over)
            if self._vehicle.armed:
                raise PreconditionFailed(_ARMED, remedy=_DISARM)
            if restart.began_again:
                raise PreconditionFailed(
                    _RESTARTED, remedy="Leave the sticks alone, and begin again."
                )
            if restart.done:  # by its heartbeats only: it hardly has, but its flag may be gone
                restart.overlook_pause()
                await self._block.renew()

    def _now(self) -> dict[int, int]:
        frame = self._vehicle.latest.get(_CHANNELS)
        return {} if frame is None else _pulses_of(frame)

    def _check(self, moved: list[int]) -> None:
        """Refuse what was moved too little, or cannot be written, before anything is."""
        known = self._parameters.known
        names = _DRIVING if self._vehicle.family.drives else _FLYING
        sticks = {name: round(known[name].value) for name in names if name in known}
        still = [name for name, channel in sticks.items() if channel not in moved]
        if still or not moved:
            told = ", ".join(name.removeprefix("RCMAP_").lower() for name in still) or "no stick"
            raise DeviceRejected(
                f"calibrate radio: not moved far enough: {told}; nothing was written",
                remedy="Repeat it, and move each stick to both of its ends.",
            )
        missing = [name for channel in moved for name in _names(channel) if name not in known]
        if missing:
            raise DeviceRejected(
                f"calibrate radio: the vehicle has no parameter {missing[0]}; nothing was written"
            )

    def _wanted(self, channel: int, low: int, middle: int, high: int) -> tuple[int, int, int]:
        """Return the lower end, the upper end, and where the channel rests, us.

        A throttle that only pushes rests at its lower end; one that also pulls, in the middle.
        """
        known = self._parameters.known
        throttle = _THROTTLE in known and round(known[_THROTTLE].value) == channel
        pulls = _REVERSED in known and known[_REVERSED].value < 0
        pushes = throttle and self._vehicle.family.flies and not pulls
        return low, high, low if pushes else middle

    async def _write(self, wanted: dict[int, tuple[int, int, int]]) -> list[str]:
        """Write all channels while it is disarmed; return what was written.

        :raises RcpError: with what was written so far in its details.
        """
        written: list[str] = []
        for channel, values in wanted.items():
            for name, value in zip(_names(channel), values, strict=True):
                try:
                    if self._vehicle.armed:
                        raise PreconditionFailed(_ARMED, remedy=_DISARM)
                    await self._parameters.write(name, value)
                except RcpError as error:
                    error.details = {**(error.details or {}), "written": written}
                    raise
                written.append(f"{name} = {value}")
        return written


def _names(channel: int) -> tuple[str, str, str]:
    return f"RC{channel}_MIN", f"RC{channel}_MAX", f"RC{channel}_TRIM"


def _pulses_of(frame: Frame) -> dict[int, int]:
    """Return the pulses of the channels that there are, by number."""
    f = frame.fields()
    found = {n: f[f"chan{n}_raw"] for n in range(1, min(16, f["chancount"]) + 1)}
    return {n: pulse for n, pulse in found.items() if _LOWEST <= pulse <= _HIGHEST}
