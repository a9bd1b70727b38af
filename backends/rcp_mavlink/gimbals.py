"""Gimbals: turned by their manager (protocol v2) if there is one, otherwise as a legacy mount."""

from __future__ import annotations

import math
import time
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

from rcp_kernel.errors import (
    DeviceRejected,
    DeviceTimeout,
    OutOfRange,
    PreconditionFailed,
    RcpError,
)
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.frames import Frame
from rcp_mavlink.gimbal_list import GimbalKey, GimbalList
from rcp_mavlink.hub import Hub
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.vehicle import Vehicle

__all__ = ["TURNING", "Gimbals", "is_close"]

TURNING = 10.0  # s
_CLOSE = 0.035  # rad
_MOUNT_CONTROL, _CONFIGURE, _PITCH_YAW, _INTERVAL = 205, 1001, 1000, 511
_STATUS = "GIMBAL_DEVICE_ATTITUDE_STATUS"
_YAW_LOCK, _IN_VEHICLE, _IN_EARTH = 16, 32, 64
_FOLLOW = 0  # yaw is relative to the vehicle's heading
_REPORTS = 5.0  # Hz
_UNCHANGED, _GIVE_UP = -1.0, -3.0


class Gimbals:
    """The gimbals of one vehicle."""

    def __init__(
        self,
        hub: Hub,
        vehicle: Vehicle,
        commands: Commands,
        intervals: Intervals,
        gimbals: GimbalList,
    ) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._commands, self._intervals = commands, intervals
        self._list = gimbals

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {"action/gimbal": self.turn, "service/gimbal/release": self.release}

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="action/gimbal", description="Point a camera.", timeout=30, max_age=30.0, input=m.Gimbal, output=m.Gimbal, examples=({"pitch": -0.5}, {"pitch": -0.5, "gimbal": 1})),
            Resource(name="service/gimbal/release", description="Give up the control of a gimbal that `action/gimbal` has taken; completes when its manager shows it.", input=m.ByGimbal | None, examples=(None, {"gimbal": 1}), timeout=30),
        ]  # fmt: skip

    async def turn(self, given: m.Gimbal, _: Progress) -> m.Gimbal:
        """Point the camera; completes when the gimbal confirms the direction."""
        key = await self._list.find(given.gimbal, given.manager)
        if key is None:
            return await self._turn_mount(given)
        info = self._list.information(key)
        _check(given.pitch, info["pitch_min"], info["pitch_max"], "pitch")
        _check(given.yaw, info["yaw_min"], info["yaw_max"], "yaw")
        return await self._turn_managed(given, key)

    async def release(self, given: m.ByGimbal | None, _: Progress) -> None:
        """Give up the control of a gimbal, for a pilot or another ground station.

        :raises PreconditionFailed: no manager is there.
        :raises DeviceTimeout: the manager does not show it.
        """
        given = given or m.ByGimbal()
        key = await self._list.find(given.gimbal, given.manager)
        if key is None:
            raise PreconditionFailed(
                "the vehicle has no gimbal manager",
                remedy="A mount of the older protocol has no control to release.",
            )
        params = (_GIVE_UP, _GIVE_UP, _UNCHANGED, _UNCHANGED)
        await self._configure(key, params)
        status = await self._list.status(key)
        if status is None or self._list.controls(status):
            shown = "does not show it" if status is None else "still shows this gateway in control"
            raise DeviceTimeout(f"gimbal: accepted, but the manager {shown}")

    # Protocol v2

    async def _configure(self, key: GimbalKey, params: tuple[float, float, float, float]) -> None:
        command = Command(_CONFIGURE, params, z=float(key.device), component=key.manager)
        await self._commands.send(command, "gimbal control")

    async def _turn_managed(self, given: m.Gimbal, key: GimbalKey) -> m.Gimbal:
        config = self._hub.config
        us = (float(config.source_system), float(config.source_component))
        try:
            await self._configure(key, (*us, _UNCHANGED, _UNCHANGED))
        except DeviceRejected:  # a manager that accepts every sender does not implement control
            self._vehicle.check()
        pitch, yaw = math.degrees(given.pitch), math.degrees(given.yaw)
        command = Command(
            _PITCH_YAW,
            (pitch, yaw, math.nan, math.nan),
            _FOLLOW,
            z=float(key.device),
            component=key.manager,
        )
        async with self.seen(key) as looks:
            await self._commands.send(command, "gimbal")
            looks.clear()
            return await self._until(given, lambda: looks[0] if looks else None)

    @asynccontextmanager
    async def seen(self, key: GimbalKey) -> AsyncGenerator[list[m.Gimbal]]:
        """Have a gimbal report while entered; yield its latest direction, relative to the vehicle."""
        looks: list[m.Gimbal] = []

        def take(frame: Frame) -> None:
            fields = frame.fields()
            if self._list.reports(key, frame, fields.get("gimbal_device_id", 0)):
                looks[:] = [self._direction(fields, key)]

        with self._vehicle.listening(_STATUS, take, anybody=True):
            if key.manager == self._vehicle.component:
                async with self._reporting(_STATUS):
                    yield looks
                return
            component = self._list.component(key)
            number = float(self._hub.dialect.by_name[_STATUS].id)
            with suppress(RcpError):  # most report by themselves
                every = Command(_INTERVAL, (number, 1e6 / _REPORTS, 0.0, 0.0), component=component)
                await self._commands.send(every, f"{_STATUS} of a gimbal")
            try:
                yield looks
            finally:
                usual = Command(_INTERVAL, (number, 0.0, 0.0, 0.0), component=component)
                with suppress(RcpError):
                    self._commands.send_once(usual)

    @asynccontextmanager
    async def _reporting(self, message: str) -> AsyncGenerator[None]:
        known = message in self._hub.dialect.by_name
        release = self._intervals.want(message, _REPORTS) if known else lambda: None
        try:
            yield
        finally:
            release()

    def _direction(self, f: dict[str, Any], key: GimbalKey) -> m.Gimbal:
        """Return the direction relative to the vehicle."""
        w, x, y, z = f["q"]
        pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        flags = f["flags"]
        earth = flags & _IN_EARTH or (flags & _YAW_LOCK and not flags & _IN_VEHICLE)
        if earth:
            yaw -= self.heading()
        return m.Gimbal(pitch, math.remainder(yaw, math.tau), key.device, key.manager)

    def heading(self) -> float:
        """Return the heading of the vehicle, rad clockwise from north; 0 if it does not tell."""
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

        async with self._reporting("MOUNT_STATUS"):
            return await self._until(given, looks)

    async def _until(self, given: m.Gimbal, looks: Callable[[], m.Gimbal | None]) -> m.Gimbal:
        """Wait until it reaches the direction; return the actual one.

        :raises DeviceTimeout: it does not reach the direction, or does not report one.
        """

        def there() -> bool:
            now = looks()
            return now is not None and is_close(now, given, _CLOSE)

        if not await self._vehicle.until(there, TURNING):
            now = looks()
            where = "it does not report its direction" if now is None else (
                f"it points to {now.pitch:.2f}, {now.yaw:.2f} rad"
            )  # fmt: skip
            raise DeviceTimeout(f"gimbal: accepted, but {where}")
        return looks() or given


def is_close(one: m.Gimbal, other: m.Gimbal, angle: float) -> bool:
    """Return whether two directions differ by less than an angle in pitch and in yaw."""
    yaw = math.remainder(one.yaw - other.yaw, math.tau)
    return abs(one.pitch - other.pitch) < angle and abs(yaw) < angle


def _check(angle: float, least: float, most: float, what: str) -> None:
    if least < most and not least - _CLOSE <= angle <= most + _CLOSE:
        raise OutOfRange(
            f"the gimbal's {what} range is {least:.2f} to {most:.2f} rad",
            details={"pointer": f"/{what}"},
        )
