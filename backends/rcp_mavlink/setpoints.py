"""Set-points: a velocity or an attitude, sent over and over as long as it stands."""

from __future__ import annotations

import asyncio
import math
from typing import Any

from rcp_kernel.errors import ModeForbids, PreconditionFailed
from rcp_mavlink import messages as m
from rcp_mavlink.hub import Hub
from rcp_mavlink.motion import Motion
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Setpoints"]

_RATE = 10.0  # Hz
_PARTING = 10  # times that rest is sent before it is left at that
_BODY_FRAME = 8
_VELOCITY_AND_YAW_RATE = 0b0101_1100_0111
_ATTITUDE_ALONE = 0b0000_0111


class Setpoints:
    """What one vehicle is led by; a new one takes the place of the one before it."""

    def __init__(self, hub: Hub, vehicle: Vehicle, motion: Motion) -> None:
        self._hub, self._vehicle, self._motion = hub, vehicle, motion
        self._task: asyncio.Task[None] | None = None
        self._message: Any = None
        self._left: int | None = None

    async def velocity(self, value: m.Velocity) -> None:
        """Move so in its own axes; all zeros is rest."""
        vehicle = self._vehicle
        resting = not (value.x or value.y or value.z or value.yaw_rate)
        if resting and (self._task is None or not self._leads()):
            self.end()
            return
        self._check()
        message = self._hub.dialect.module.MAVLink_set_position_target_local_ned_message(
            0, vehicle.system, vehicle.component, _BODY_FRAME, _VELOCITY_AND_YAW_RATE,
            0.0, 0.0, 0.0, value.x, -value.y, -value.z, 0.0, 0.0, 0.0, 0.0, -value.yaw_rate,
        )  # fmt: skip
        self._lead(message, _PARTING if resting else None)

    async def attitude(self, value: m.Attitude) -> None:
        """Hold an attitude; level with half the thrust is rest, and handed back to the autopilot."""
        vehicle = self._vehicle
        if value == m.Attitude():
            led = self._task is not None and self._leads()
            self.end()
            if led:
                await self._motion.hold()
            return
        self._check()
        q = _quaternion(value.roll, value.pitch, value.yaw)
        message = self._hub.dialect.module.MAVLink_set_attitude_target_message(
            0, vehicle.system, vehicle.component, _ATTITUDE_ALONE, q, 0.0, 0.0, 0.0, value.thrust
        )
        self._lead(message, None)

    def _leads(self) -> bool:
        vehicle = self._vehicle
        mode = "OFFBOARD" if vehicle.family.px4 else vehicle.family.guided
        return vehicle.mode == mode and vehicle.armed

    def _check(self) -> None:
        """Make sure that it would follow.

        :raises ModeForbids: it is in a mode in which it does not.
        :raises PreconditionFailed: it is not in the air.
        """
        vehicle = self._vehicle
        vehicle.check()
        if not self._leads():
            mode = "OFFBOARD" if vehicle.family.px4 else vehicle.family.guided
            raise ModeForbids(
                f"in {vehicle.mode} the vehicle follows no set-point",
                remedy=f"Arm it and bring it into {mode}: action/takeoff does both but arming.",
            )
        if vehicle.landed is True and vehicle.family.kind in ("copter", "px4"):
            raise PreconditionFailed("the vehicle is on the ground", remedy="Take off first.")

    def _lead(self, message: Any, left: int | None) -> None:
        self._message, self._left = message, left
        self._hub.send(self._vehicle, message)
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._repeat())

    async def _repeat(self) -> None:
        while self._left is None or self._left > 0:
            await asyncio.sleep(1 / _RATE)
            if self._vehicle.lost or not self._leads():
                break
            self._hub.send(self._vehicle, self._message)
            if self._left is not None:
                self._left -= 1
        self._task = None

    def end(self) -> None:
        """Say nothing more."""
        if self._task is not None:
            self._task.cancel()
            self._task = None


def _quaternion(roll: float, pitch: float, yaw: float) -> list[float]:
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
