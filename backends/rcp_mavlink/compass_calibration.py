"""The compasses of an ArduPilot, calibrated while somebody turns the vehicle all around."""

from __future__ import annotations

import asyncio
import time
from contextlib import ExitStack, suppress
from typing import Any

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, RcpError
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.frames import Frame
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.motion import Motion
from rcp_mavlink.vehicle import Vehicle

__all__ = ["CompassCalibration"]

_START, _CANCEL = 42424, 42426
_ALL, _SAVE = 0.0, 1.0
_PROGRESS, _REPORT = "MAG_CAL_PROGRESS", "MAG_CAL_REPORT"
_REPORTS = 4.0  # Hz
_STATUSES = {4: "success", 5: "failed", 6: "failed: wrong orientation", 7: "failed: wrong radius"}
_SUCCESS = 4
_SILENCE = 30.0  # s without progress or report
_TURN = "Turn the vehicle slowly until each of its sides has pointed down."


class CompassCalibration:
    """The compasses of one vehicle."""

    def __init__(
        self, vehicle: Vehicle, commands: Commands, intervals: Intervals, motion: Motion
    ) -> None:
        self._vehicle, self._commands = vehicle, commands
        self._intervals, self._motion = intervals, motion

    async def run(self, progress: Progress) -> m.Calibrated:
        """Calibrate all compasses; completes when each has reported its result, and saved it.

        :raises DeviceRejected: one has failed.
        :raises DeviceTimeout: the vehicle reports nothing.
        """
        parts: dict[int, int] = {}
        reports: dict[int, dict[str, Any]] = {}
        heard = time.monotonic()

        def take(frame: Frame) -> None:
            nonlocal heard
            f, heard = frame.fields(), time.monotonic()
            if frame.definition.name == _REPORT:
                if f["cal_status"] in _STATUSES:
                    reports[f["compass_id"]] = f
                return
            parts[f["compass_id"]] = f["completion_pct"]
            for compass in range(8):
                if f["cal_mask"] >> compass & 1:
                    parts.setdefault(compass, 0)
            least = min(parts.values())
            progress(m.Calibrating(_TURN, None), fraction=least / 100)

        def over() -> bool:
            return reports.keys() >= parts.keys() and bool(reports)

        with ExitStack() as stack:
            for name in (_PROGRESS, _REPORT):
                stack.enter_context(self._vehicle.listening(name, take))
                stack.callback(self._intervals.want(name, _REPORTS))
            try:
                start = Command(_START, (_ALL, 0.0, _SAVE, 0.0))
                await self._commands.send(start, "calibrate compass")
                progress(m.Calibrating(_TURN, None), fraction=0.0)
                await self._vehicle.until(lambda: over() or time.monotonic() - heard > _SILENCE)
                if not over():
                    raise DeviceTimeout("calibrate compass: the vehicle reports no progress")
            except (asyncio.CancelledError, DeviceTimeout):
                with suppress(RcpError):
                    await self._motion.shielded(self._cancel)
                raise
        return self._result(reports)

    async def _cancel(self) -> None:
        await self._commands.send(Command(_CANCEL), "calibrate compass: cancel")

    @staticmethod
    def _result(reports: dict[int, dict[str, Any]]) -> m.Calibrated:
        texts = [
            f"compass {number + 1}: {_STATUSES[f['cal_status']]}, fitness {f['fitness']:.1f}, "
            f"offsets {f['ofs_x']:.0f} {f['ofs_y']:.0f} {f['ofs_z']:.0f}"
            for number, f in sorted(reports.items())
        ]
        if any(f["cal_status"] != _SUCCESS for f in reports.values()):
            raise DeviceRejected(
                f"calibrate compass: {'; '.join(texts)}",
                remedy="Repeat it away from metal and currents, and turn the vehicle to all sides.",
                details={"texts": texts},
            )
        return m.Calibrated("compass", texts)
