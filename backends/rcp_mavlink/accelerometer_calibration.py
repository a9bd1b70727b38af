"""The accelerometers of an ArduPilot, calibrated in six positions that somebody puts it in."""

from __future__ import annotations

import asyncio

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, PreconditionFailed
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.frames import Frame
from rcp_mavlink.vehicle import Vehicle

__all__ = ["AccelerometerCalibration"]

_CALIBRATION, _POSITION = 241, 42429
_SIX = 1.0  # fifth parameter of PREFLIGHT_CALIBRATION
_POSITIONS = {1: "level", 2: "on its left side", 3: "on its right side", 4: "nose down", 5: "nose up", 6: "on its back"}  # fmt: skip
_SUCCESS, _FAILED = 16777215, 16777216
_STARTING = 5.0  # s for the first position to be asked for
_ASKED = "Put the vehicle {}, keep it still, and execute service/calibrate/continue."


class AccelerometerCalibration:
    """The accelerometers of one vehicle."""

    def __init__(self, vehicle: Vehicle, commands: Commands) -> None:
        self._vehicle, self._commands = vehicle, commands
        self._asked: int | None = None
        """The position that the vehicle waits for; None if it waits for none."""

    async def run(self, progress: Progress) -> m.Calibrated:
        """Calibrate in six positions; completes when the vehicle reports success.

        :raises DeviceRejected: the vehicle reports a failure.
        :raises DeviceTimeout: it does not ask for a position.
        """
        done: list[int] = []
        asked: list[int] = []

        def take(frame: Frame) -> None:
            f = frame.fields()
            if f["command"] != _POSITION:
                return
            position = round(f["param1"])
            if position in (_SUCCESS, _FAILED):
                done.append(position)
            elif position in _POSITIONS:
                self._ask(position, asked, progress)

        with self._vehicle.listening("COMMAND_LONG", take):
            try:
                await self._commands.send(
                    Command(_CALIBRATION, x=_SIX), "calibrate accelerometer_full"
                )
                progress()
                if not await self._vehicle.until(lambda: bool(asked or done), _STARTING):
                    raise DeviceTimeout(
                        "calibrate accelerometer_full: accepted, but no position is asked for"
                    )
                await self._vehicle.until(lambda: bool(done))
            finally:
                self._asked = None
        if done[0] == _FAILED:
            raise DeviceRejected(
                "calibrate accelerometer_full: the vehicle reports a failure",
                remedy="Repeat it; in each position, keep the vehicle still until the next is asked for.",
            )
        return m.Calibrated("accelerometer_full", [_POSITIONS[n] for n in asked])

    def _ask(self, position: int, asked: list[int], progress: Progress) -> None:
        if asked[-1:] == [position]:  # it repeats it until it is answered
            return
        asked.append(position)
        self._asked = position
        name = _POSITIONS[position]
        progress(m.Calibrating(_ASKED.format(name), name), fraction=(position - 1) / 6)

    async def proceed(self, _: None, __: Progress) -> m.Calibrating:
        """Tell the vehicle that it is in the position that it waits for.

        :raises PreconditionFailed: it waits for none.
        """
        position = self._asked
        if position is None:
            raise PreconditionFailed(
                "calibrate: the vehicle waits for no position",
                remedy="Start action/calibrate with `accelerometer_full` first.",
            )
        self._asked = None
        command = Command(_POSITION, (float(position), 0.0, 0.0, 0.0))
        try:
            await self._commands.send(command, "calibrate: position")
        except (DeviceRejected, DeviceTimeout, asyncio.CancelledError):
            self._asked = position
            raise
        return m.Calibrating("", _POSITIONS[position])
