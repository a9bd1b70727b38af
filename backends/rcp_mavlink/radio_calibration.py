"""The channels of a remote control, measured while somebody moves its sticks, and written to an ArduPilot."""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from contextlib import contextmanager

from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    PreconditionFailed,
    UnsupportedOperation,
)
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.frames import Frame
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.vehicle import Vehicle

__all__ = ["RadioCalibration"]

_CHANNELS = "RC_CHANNELS"
_RATE = 20.0  # Hz
_WAIT = 3.0  # s for the first message
_LOWEST, _HIGHEST = 800, 2200  # µs: ArduPilot takes no other pulses
_USED = 300  # µs by which a channel that is in use was moved at least
_STICKS = ("RCMAP_ROLL", "RCMAP_PITCH", "RCMAP_THROTTLE", "RCMAP_YAW")
_THROTTLE = "RCMAP_THROTTLE"
_MIDDLE = "Put all sticks in the middle, the throttle too, and execute service/calibrate/continue."
_ENDS = "Move all sticks and switches to all their ends, then execute service/calibrate/continue."


class RadioCalibration:
    """The remote control of one vehicle."""

    def __init__(self, vehicle: Vehicle, intervals: Intervals, parameters: Parameters) -> None:
        self._vehicle, self._intervals, self._parameters = vehicle, intervals, parameters
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

        :raises UnsupportedOperation: the autopilot is a PX4.
        :raises AdapterUnavailable: no pulses of a remote control are reported.
        :raises DeviceRejected: a stick that flies the vehicle was not moved.
        """
        if self._vehicle.family.px4:
            raise UnsupportedOperation(
                "calibrate radio: only for ArduPilot",
                remedy="Calibrate the remote control of a PX4 with QGroundControl.",
            )
        with self._pulses():
            await self._first()
            middle: dict[int, int] = {}
            await self._ask("middle", _MIDDLE, progress, 0.0)
            middle.update(self._now())
            low, high = dict(middle), dict(middle)

            def take(frame: Frame) -> None:
                for channel, pulse in _pulses_of(frame).items():
                    low[channel] = min(low.get(channel, pulse), pulse)
                    high[channel] = max(high.get(channel, pulse), pulse)

            with self._vehicle.listening(_CHANNELS, take):
                await self._ask("ends", _ENDS, progress, 0.4)
        moved = [channel for channel in middle if high[channel] - low[channel] >= _USED]
        self._check(moved)
        texts = [
            await self._write(channel, low[channel], middle[channel], high[channel])
            for channel in moved
        ]
        return m.Calibrated("radio", texts)

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
        since = received.get(_CHANNELS, 0.0)
        fresh = await self._vehicle.until(lambda: received.get(_CHANNELS, 0.0) > since, _WAIT)
        if not fresh or not self._now():
            raise AdapterUnavailable(
                "calibrate radio: the vehicle reports no pulses of a remote control",
                remedy="Switch the remote control on, and check that its receiver is bound.",
            )

    async def _ask(self, step: str, text: str, progress: Progress, part: float) -> None:
        """Wait until somebody says that it is done.

        :raises PreconditionFailed: the vehicle was armed meanwhile.
        """
        self._going_on, self._step = asyncio.Event(), step
        progress(m.Calibrating(text, step), fraction=part)
        going_on = self._going_on
        await self._vehicle.until(lambda: going_on.is_set() or self._vehicle.armed)
        if self._vehicle.armed:
            raise PreconditionFailed("calibrate radio: the vehicle was armed meanwhile")

    def _now(self) -> dict[int, int]:
        frame = self._vehicle.latest.get(_CHANNELS)
        return {} if frame is None else _pulses_of(frame)

    def _check(self, moved: list[int]) -> None:
        known = self._parameters.known
        sticks = {name: round(known[name].value) for name in _STICKS if name in known}
        still = [name for name, channel in sticks.items() if channel not in moved]
        if still or not moved:
            names = ", ".join(name.removeprefix("RCMAP_").lower() for name in still) or "no stick"
            raise DeviceRejected(
                f"calibrate radio: not moved far enough: {names}; nothing was written",
                remedy="Repeat it, and move each stick to both of its ends.",
            )

    async def _write(self, channel: int, low: int, middle: int, high: int) -> str:
        """Write one channel, whose throttle rests at its lower end."""
        known = self._parameters.known
        throttle = _THROTTLE in known and round(known[_THROTTLE].value) == channel
        rest = low if throttle else middle
        for name, value in (("MIN", low), ("MAX", high), ("TRIM", rest)):
            await self._parameters.write(f"RC{channel}_{name}", value)
        return f"channel {channel}: {low} to {high} us, rests at {rest} us"


def _pulses_of(frame: Frame) -> dict[int, int]:
    """Return the pulses of the channels that there are, by number."""
    f = frame.fields()
    found = {n: f[f"chan{n}_raw"] for n in range(1, min(16, f["chancount"]) + 1)}
    return {n: pulse for n, pulse in found.items() if _LOWEST <= pulse <= _HIGHEST}
