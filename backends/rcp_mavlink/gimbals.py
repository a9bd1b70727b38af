"""The gimbal: by its manager (protocol v2) if there is one, otherwise as a legacy mount."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, OutOfRange, RcpError
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Gimbals"]

_TURNING = 10.0  # s
_CLOSE = 0.035  # rad
_MOUNT_CONTROL, _CONFIGURE, _PITCH_YAW = 205, 1001, 1000
_STATUS, _INFORMATION = "GIMBAL_DEVICE_ATTITUDE_STATUS", "GIMBAL_MANAGER_INFORMATION"
_YAW_LOCK, _IN_VEHICLE, _IN_EARTH = 16, 32, 64
_FOLLOW = 0  # yaw is relative to the vehicle's heading
_REPORTS = 5.0  # Hz


class Gimbals:
    """The gimbal of one vehicle."""

    def __init__(
        self, hub: Hub, vehicle: Vehicle, commands: Commands, intervals: Intervals
    ) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._commands, self._intervals = commands, intervals
        self._manager: Frame | None = None

    async def turn(self, given: m.Gimbal, progress: Progress) -> m.Gimbal:
        """Point the camera; completes when the gimbal confirms the direction."""
        manager = self._manager or await self._find()
        if manager is None:
            return await self._turn_mount(given)
        self._manager = manager
        info = manager.fields()
        _check(given.pitch, info["pitch_min"], info["pitch_max"], "pitch")
        _check(given.yaw, info["yaw_min"], info["yaw_max"], "yaw")
        return await self._turn_managed(given, manager.component, info["gimbal_device_id"])

    async def _find(self) -> Frame | None:
        """Return the information of the gimbal manager; None if there is none."""
        if _INFORMATION not in self._hub.dialect.by_name:
            return None
        found: list[Frame] = []
        with self._vehicle.listening(_INFORMATION, found.append, anybody=True):
            try:
                await self._intervals.request(_INFORMATION)
            except RcpError:
                self._vehicle.check()
                return None
            await self._vehicle.until(lambda: bool(found), self._hub.config.timeout)
        return found[0] if found else None

    # Protocol v2

    async def _turn_managed(self, given: m.Gimbal, manager: int, device: int) -> m.Gimbal:
        config = self._hub.config
        us = (float(config.source_system), float(config.source_component), -1.0, -1.0)
        try:
            configure = Command(_CONFIGURE, us, z=float(device), component=manager)
            await self._commands.send(configure, "gimbal control")
        except DeviceRejected:  # a manager that accepts every sender does not implement control
            self._vehicle.check()
        pitch, yaw = math.degrees(given.pitch), math.degrees(given.yaw)
        command = Command(
            _PITCH_YAW,
            (pitch, yaw, math.nan, math.nan),
            _FOLLOW,
            z=float(device),
            component=manager,
        )
        looks: list[m.Gimbal] = []

        def take(frame: Frame) -> None:
            looks[:] = [self._seen(frame.fields())]

        with self._vehicle.listening(_STATUS, take, anybody=True):
            await self._commands.send(command, "gimbal")
            looks.clear()
            return await self._until(given, _STATUS, lambda: looks[0] if looks else None)

    def _seen(self, f: dict[str, Any]) -> m.Gimbal:
        """Return the direction relative to the vehicle."""
        w, x, y, z = f["q"]
        pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        flags = f["flags"]
        earth = flags & _IN_EARTH or (flags & _YAW_LOCK and not flags & _IN_VEHICLE)
        if earth:
            yaw -= self._heading()
        return m.Gimbal(pitch, math.remainder(yaw, math.tau))

    def _heading(self) -> float:
        frame = self._vehicle.latest.get("ATTITUDE")
        if frame is not None:
            return frame.fields()["yaw"]
        frame = self._vehicle.latest.get("GLOBAL_POSITION_INT")
        heading = 0 if frame is None else frame.fields()["hdg"]
        return math.radians(heading / 100) if heading != 65535 else 0.0

    # Legacy mount

    async def _turn_mount(self, given: m.Gimbal) -> m.Gimbal:
        pitch, yaw = math.degrees(given.pitch), math.degrees(given.yaw)
        await self._commands.send(Command(_MOUNT_CONTROL, (pitch, 0.0, yaw, 0.0), z=2.0), "gimbal")
        since = time.monotonic()

        def looks() -> m.Gimbal | None:
            frame = self._vehicle.latest.get("MOUNT_STATUS")
            if frame is None or self._vehicle.received_at["MOUNT_STATUS"] < since:
                return None
            f = frame.fields()
            return m.Gimbal(
                math.radians(f["pointing_a"] / 100), math.radians(f["pointing_c"] / 100)
            )

        return await self._until(given, "MOUNT_STATUS", looks)

    async def _until(
        self, given: m.Gimbal, message: str, looks: Callable[[], m.Gimbal | None]
    ) -> m.Gimbal:
        """Wait until it reaches the direction; return the actual one.

        :raises DeviceTimeout: it does not reach the direction, or does not report one.
        """

        def there() -> bool:
            now = looks()
            return (
                now is not None
                and abs(now.pitch - given.pitch) < _CLOSE
                and abs(math.remainder(now.yaw - given.yaw, math.tau)) < _CLOSE
            )

        known = message in self._hub.dialect.by_name
        release = self._intervals.want(message, _REPORTS) if known else lambda: None
        try:
            seen = await self._vehicle.until(there, _TURNING)
        finally:
            release()
        if not seen:
            now = looks()
            where = "it does not report its direction" if now is None else (
                f"it points to {now.pitch:.2f}, {now.yaw:.2f} rad"
            )  # fmt: skip
            raise DeviceTimeout(f"gimbal: accepted, but {where}")
        return looks() or given


def _check(angle: float, least: float, most: float, what: str) -> None:
    if least < most and not least - _CLOSE <= angle <= most + _CLOSE:
        raise OutOfRange(
            f"the gimbal's {what} range is {least:.2f} to {most:.2f} rad",
            details={"pointer": f"/{what}"},
        )
