"""The calibrations of PX4, whose progress and result are texts that begin with `[cal]`."""

from __future__ import annotations

import asyncio
import re
import time
from contextlib import suppress

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, RcpError
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.motion import Motion
from rcp_mavlink.vehicle import Text, Vehicle

__all__ = ["TextCalibration"]

_CALIBRATION = 241
_COMMANDS = {
    "gyro": Command(_CALIBRATION, (1.0, 0.0, 0.0, 0.0)),
    "compass": Command(_CALIBRATION, (0.0, 1.0, 0.0, 0.0)),
    "barometer": Command(_CALIBRATION, (0.0, 0.0, 1.0, 0.0)),
    "accelerometer_full": Command(_CALIBRATION, x=1.0),
    "level": Command(_CALIBRATION, x=2.0),
    "accelerometer": Command(_CALIBRATION, x=4.0),
}
_PREFIX = "[cal] "
_PROGRESS = re.compile(r"progress <(\d+)>")
_DETECTED = re.compile(r"(down|up|left|right|front|back) orientation detected")
_DONE, _FAILED, _CANCELLED = "calibration done", "calibration failed", "calibration cancelled"
_SILENCE = 60.0  # s without a text


class TextCalibration:
    """The sensors of one vehicle."""

    def __init__(self, vehicle: Vehicle, commands: Commands, motion: Motion) -> None:
        self._vehicle, self._commands, self._motion = vehicle, commands, motion

    async def run(self, what: str, progress: Progress) -> m.Calibrated:
        """Calibrate a sensor; completes when a text reports it.

        :raises DeviceRejected: a text reports a failure.
        :raises DeviceTimeout: no text reports anything.
        """
        said: list[str] = []
        heard, fraction = time.monotonic(), 0.0
        position: str | None = None

        def take(text: Text) -> None:
            nonlocal heard, fraction, position
            if not text.text.startswith(_PREFIX):
                return
            words, heard = text.text.removeprefix(_PREFIX), time.monotonic()
            said.append(words)
            if (part := _PROGRESS.search(words)) is not None:
                fraction = max(fraction, min(1.0, int(part[1]) / 100))
            if (side := _DETECTED.match(words)) is not None:
                position = side[1]
            progress(m.Calibrating(words, position), fraction=fraction)

        def over() -> bool:
            return any(words.startswith((_DONE, _FAILED, _CANCELLED)) for words in said)

        self._vehicle.on_text.append(take)
        try:
            await self._commands.send(_COMMANDS[what], f"calibrate {what}")
            await self._vehicle.until(lambda: over() or time.monotonic() - heard > _SILENCE)
            if not over():
                raise DeviceTimeout(f"calibrate {what}: the vehicle does not report its end")
        except (asyncio.CancelledError, DeviceTimeout):
            with suppress(RcpError):
                await self._motion.shielded(self._cancel)
            raise
        finally:
            if take in self._vehicle.on_text:
                self._vehicle.on_text.remove(take)
        if not said[-1].startswith(_DONE):
            raise DeviceRejected(f"calibrate {what}: {said[-1]}", details={"texts": said})
        return m.Calibrated(what, said)

    async def _cancel(self) -> None:
        """Cancel it: PX4 reads a command without a sensor so."""
        await self._commands.send(Command(_CALIBRATION), "calibrate: cancel")
