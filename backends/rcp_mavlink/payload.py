"""What a vehicle carries and what is done with it on the ground: gimbal, camera, calibration."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from typing import Any

from rcp_kernel.errors import DeviceTimeout
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Payload"]

_TURNING = 10.0  # s
_CLOSE = 0.035  # rad
_CALIBRATIONS: dict[str, Command] = {
    "gyro": Command(241, (1.0, 0.0, 0.0, 0.0)),
    "barometer": Command(241, (0.0, 0.0, 1.0, 0.0)),
    "level": Command(241, x=2.0),
    "accelerometer": Command(241, x=4.0),
}


class Payload:
    """The gimbal, the camera and the sensors of one vehicle."""

    def __init__(self, vehicle: Vehicle, commands: Commands, intervals: Intervals) -> None:
        self._vehicle, self._commands, self._intervals = vehicle, commands, intervals

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return what each path runs."""
        return {
            "action/gimbal": self.gimbal,
            "action/camera/photo": self.photo,
            "action/calibrate": self.calibrate,
        }

    async def gimbal(self, given: m.Gimbal, progress: Progress) -> m.Gimbal:
        """Turn the camera; done when the mount says that it looks there, as far as it can."""
        pitch, yaw = math.degrees(given.pitch), math.degrees(given.yaw)
        await self._commands.send(Command(205, (pitch, 0.0, yaw, 0.0), z=2.0), "gimbal")
        release = self._intervals.want("MOUNT_STATUS", 5.0)
        since = time.monotonic()
        try:
            seen = await self._vehicle.until(lambda: self._turned(given, since), _TURNING)
        finally:
            release()
        if not seen:
            raise DeviceTimeout("gimbal: accepted, but it does not look there")
        return self._looks() or given

    def _looks(self) -> m.Gimbal | None:
        frame = self._vehicle.latest.get("MOUNT_STATUS")
        if frame is None:
            return None
        f = frame.fields()
        return m.Gimbal(math.radians(f["pointing_a"] / 100), math.radians(f["pointing_c"] / 100))

    def _turned(self, given: m.Gimbal, since: float) -> bool:
        looks = self._looks()
        if looks is None or self._vehicle.came["MOUNT_STATUS"] < since:
            return False
        return abs(looks.pitch - given.pitch) < _CLOSE and abs(looks.yaw - given.yaw) < _CLOSE

    async def photo(self, _: None, progress: Progress) -> m.Photo:
        """Take a picture; done when the camera says so."""
        taken: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

        def take(frame: Any) -> None:
            if not taken.done():
                taken.set_result(frame.fields())

        with self._vehicle.listening("CAMERA_FEEDBACK", take):
            await self._commands.send(Command(203, x=1.0), "photo")
            try:
                async with asyncio.timeout(_TURNING):
                    f = await taken
            except TimeoutError:
                raise DeviceTimeout("photo: accepted, but the camera does not say so") from None
        return m.Photo(f["img_idx"], f["lat"] / 1e7, f["lng"] / 1e7, f["alt_rel"])

    async def calibrate(self, given: m.Calibrate | None, progress: Progress) -> m.Calibrated:
        """Calibrate a sensor; the acknowledgement comes when it is done."""
        what = (given or m.Calibrate()).what
        since = time.monotonic()
        await self._commands.send(
            _CALIBRATIONS[what], f"calibrate {what}", lambda part: progress(fraction=part)
        )
        return m.Calibrated(what, self._vehicle.texts_since(since, severity=6))
