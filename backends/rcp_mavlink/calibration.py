"""Sensor calibration, on the ground."""

from __future__ import annotations

import time

from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Calibration"]

_CALIBRATIONS: dict[str, Command] = {
    "gyro": Command(241, (1.0, 0.0, 0.0, 0.0)),
    "barometer": Command(241, (0.0, 0.0, 1.0, 0.0)),
    "level": Command(241, x=2.0),
    "accelerometer": Command(241, x=4.0),
}


class Calibration:
    """The sensors of one vehicle."""

    def __init__(self, vehicle: Vehicle, commands: Commands) -> None:
        self._vehicle, self._commands = vehicle, commands

    async def calibrate(self, given: m.Calibrate | None, progress: Progress) -> m.Calibrated:
        """Calibrate a sensor; the vehicle acknowledges when it is done."""
        what = (given or m.Calibrate()).what
        since = time.monotonic()
        await self._commands.send(
            _CALIBRATIONS[what], f"calibrate {what}", lambda part: progress(fraction=part)
        )
        return m.Calibrated(what, self._vehicle.texts_since(since, severity=6))
