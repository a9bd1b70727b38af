"""Sensor calibration, on the ground and disarmed."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from typing import Any

from rcp_kernel.errors import PreconditionFailed
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.accelerometer_calibration import AccelerometerCalibration
from rcp_mavlink.arming_block import ArmingBlock
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.compass_calibration import CompassCalibration
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.motion import Motion
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.radio_calibration import RadioCalibration
from rcp_mavlink.text_calibration import TextCalibration
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Calibration"]

_ACKNOWLEDGED: dict[str, Command] = {
    "gyro": Command(241, (1.0, 0.0, 0.0, 0.0)),
    "barometer": Command(241, (0.0, 0.0, 1.0, 0.0)),
    "level": Command(241, x=2.0),
    "accelerometer": Command(241, x=4.0),
}
"""Those that an ArduPilot acknowledges when they are done."""


class Calibration:
    """The sensors of one vehicle."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: Commands,
        intervals: Intervals,
        motion: Motion,
        parameters: Parameters,
        block: ArmingBlock,
    ) -> None:
        self._vehicle, self._commands = vehicle, commands
        self._compass = CompassCalibration(vehicle, commands, intervals, motion)
        self._accelerometer = AccelerometerCalibration(vehicle, commands)
        self._radio = RadioCalibration(vehicle, intervals, parameters, block)
        self._texts = TextCalibration(vehicle, commands, motion)

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {
            "action/calibrate": self.calibrate,
            "service/calibrate/continue": self._proceed,
        }

    async def calibrate(self, given: m.Calibrate | None, progress: Progress) -> m.Calibrated:
        """Calibrate a sensor; completes when the vehicle reports that it is done.

        :raises PreconditionFailed: the vehicle is armed.
        """
        what = (given or m.Calibrate()).what
        if self._vehicle.armed:
            raise PreconditionFailed(
                "calibrate: the vehicle is armed", remedy="Land it and disarm it first."
            )
        if what == "radio":
            return await self._radio.run(progress)
        if self._vehicle.family.px4:
            return await self._texts.run(what, progress)
        match what:
            case "compass":
                return await self._compass.run(progress)
            case "accelerometer_full":
                return await self._accelerometer.run(progress)
            case _:
                return await self._acknowledged(what, progress)

    async def _proceed(self, _: None, progress: Progress) -> m.Calibrating:
        if self._radio.waits:
            return self._radio.proceed()
        return await self._accelerometer.proceed(None, progress)

    async def _acknowledged(self, what: str, progress: Progress) -> m.Calibrated:
        since = time.monotonic()
        await self._commands.send(
            _ACKNOWLEDGED[what], f"calibrate {what}", lambda part: progress(fraction=part)
        )
        return m.Calibrated(what, self._vehicle.texts_since(since, severity=6))
