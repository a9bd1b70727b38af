"""Set-points: a velocity or an attitude, repeated while it is active."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from rcp_kernel.errors import ModeForbids, PreconditionFailed, RcpError
from rcp_kernel.spi import check_fence, fenced_off
from rcp_mavlink import messages as m
from rcp_mavlink.hub import Hub
from rcp_mavlink.motion import Motion
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Setpoints"]

_RATE = 10.0  # Hz
_PARTING = 10  # messages with zero velocity before the set-point ends
_LEADING = 6  # messages that PX4 requires before it enters the mode
_BODY_FRAME = 8
_VELOCITY_AND_YAW_RATE = 0b0101_1100_0111
_ATTITUDE_ALONE = 0b0000_0111
_FRESH = 0.1  # s for which a heading counts as the present one
_ANSWER = 0.5  # s for a heading to arrive
_NO_HEADING = 65535


class Setpoints:
    """The set-point of one vehicle; a new one replaces the previous.

    `ask` requests one message from the vehicle.
    """

    def __init__(
        self, hub: Hub, vehicle: Vehicle, motion: Motion, ask: Callable[[str], Awaitable[None]]
    ) -> None:
        self._hub, self._vehicle, self._motion, self._ask = hub, vehicle, motion, ask
        self._kept: float | None = None
        """The heading to keep while none is requested, rad."""
        self._task: asyncio.Task[None] | None = None
        self._entering: asyncio.Task[None] | None = None
        self._make: Callable[[], Any] = lambda: self._moving(m.Velocity())
        """Makes the message that is repeated."""
        self._left: int | None = None

    async def velocity(
        self, value: m.Velocity, limited: Callable[[m.Velocity], m.Velocity]
    ) -> None:
        """Send a velocity in the body frame, always within the present limits; all zeros is rest."""
        if not (value.x or value.y or value.z or value.yaw_rate):
            await self.rest()
            return
        self.check()
        self._kept = None
        await self.lead(lambda: self._moving(limited(value)))

    async def rest(self) -> None:
        """Bring it to rest by a velocity of zero, if it follows a set-point."""
        if self._task is None or not self._leads():
            self.end()
            return
        self.check()
        self._kept = None
        await self.lead(lambda: self._moving(m.Velocity()), _PARTING)

    def _moving(self, value: m.Velocity) -> Any:
        return self._hub.dialect.module.MAVLink_set_position_target_local_ned_message(
            0, self._vehicle.system, self._vehicle.component, _BODY_FRAME, _VELOCITY_AND_YAW_RATE,
            0.0, 0.0, 0.0, value.x, -value.y, -value.z, 0.0, 0.0, 0.0, 0.0, -value.yaw_rate,
        )  # fmt: skip

    async def attitude(self, value: m.Attitude) -> None:
        """Hold an attitude; level with half thrust is rest and ends the set-point."""
        vehicle = self._vehicle
        if value == m.Attitude():
            led = self._task is not None and self._leads()
            self.end()
            if led:
                await self._motion.hold()
            return
        self.check()
        heading = await self._heading(value.yaw)
        self.check()  # another command may have arrived meanwhile
        q = _quaternion(value.roll, value.pitch, heading)
        message = self._hub.dialect.module.MAVLink_set_attitude_target_message(
            0, vehicle.system, vehicle.component, _ATTITUDE_ALONE, q, 0.0, 0.0, 0.0, value.thrust
        )
        await self.lead(lambda: message)

    async def _heading(self, requested: float | None) -> float:
        """Return the heading to hold: an attitude always has one, and 0 would be north.

        :raises PreconditionFailed: the present heading is needed and not reported.
        """
        if requested is not None:
            self._kept = None
            return requested
        if self._kept is None:
            self._kept = await self._present()
        return self._kept

    async def _present(self) -> float:
        vehicle, since = self._vehicle, time.monotonic() - _FRESH
        try:
            if vehicle.received_at.get("ATTITUDE", -math.inf) < since:
                await self._ask("ATTITUDE")
            if await vehicle.until(
                lambda: vehicle.received_at.get("ATTITUDE", -math.inf) >= since, _ANSWER
            ):
                yaw = vehicle.latest["ATTITUDE"].fields()["yaw"]
                if math.isfinite(yaw):
                    return yaw
        except RcpError:  # the vehicle does not have the message, or does not respond
            vehicle.check()
        if vehicle.received_at.get("GLOBAL_POSITION_INT", -math.inf) >= since - _ANSWER:
            heading = vehicle.latest["GLOBAL_POSITION_INT"].fields()["hdg"]
            if heading != _NO_HEADING:
                return math.radians(heading / 100)
        raise PreconditionFailed(
            "the vehicle reports no heading", remedy="Give `yaw` with the attitude."
        )

    def _leads(self) -> bool:
        vehicle = self._vehicle
        return vehicle.mode == vehicle.family.led and vehicle.armed

    def check(self) -> None:
        """Check that the vehicle would follow.

        :raises ModeForbids: it accepts no set-points in its mode.
        :raises PreconditionFailed: it is not in the air.
        """
        vehicle, family = self._vehicle, self._vehicle.family
        vehicle.check()
        modes = {family.led, family.guided} if family.px4 else {family.led}
        if vehicle.mode not in modes or not vehicle.armed:
            wanted = " or ".join(sorted(modes))
            raise ModeForbids(
                f"in {vehicle.mode}{'' if vehicle.armed else ', disarmed,'} the vehicle accepts no set-points",
                remedy=f"Arm it and set mode {wanted} with action/set_mode.",
            )  # fmt: skip
        if vehicle.landed is True and family.flies:
            raise PreconditionFailed("the vehicle is on the ground", remedy="Take off first.")
        self._motion.measurement.check(strict=False)

    async def lead(self, make: Callable[[], Any], left: int | None = None) -> None:
        """Send what `make` returns again and again, in the mode for it; None: until it is ended.

        :raises ModeForbids: the vehicle does not enter the mode.
        """
        check_fence()
        self._make, self._left = make, left
        self._hub.send(self._vehicle, make())
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._repeat())
        if not self._leads():
            await self._enter()

    async def _enter(self) -> None:
        """Enter the mode for set-points: PX4 requires a stream of them first."""
        entering = self._entering
        if entering is None or entering.done():
            entering = asyncio.get_running_loop().create_task(self._entered())
            self._entering = entering
        await asyncio.wait({entering})
        if entering.cancelled():
            raise PreconditionFailed("the set-point was ended by another command")
        if (error := entering.exception()) is not None:
            self.end()
            raise error

    async def _entered(self) -> None:
        before = self._vehicle.mode
        await asyncio.sleep(_LEADING / _RATE)
        if self._vehicle.mode != before:
            raise ModeForbids(
                f"another operator or a failsafe changed the mode to {self._vehicle.mode}"
            )
        await self._motion.to_mode(self._vehicle.family.led)

    async def offboard(self) -> None:
        """Enter OFFBOARD with a set-point of rest."""
        if not self._vehicle.armed:
            raise PreconditionFailed("OFFBOARD: the vehicle is not armed", remedy="Arm it first.")
        await self.lead(lambda: self._moving(m.Velocity()))

    async def _repeat(self) -> None:
        hold = self._vehicle.family.px4  # PX4 would treat their absence as a failure
        while self._left is None or self._left > 0:
            await asyncio.sleep(1 / _RATE)
            entering = self._entering is not None and not self._entering.done()
            if fenced_off() or self._vehicle.lost or not (entering or self._leads()):
                break
            if self._motion.measurement.stale(strict=False):  # the motion can no longer be observed
                hold = True
                break
            self._hub.send(self._vehicle, self._make())
            if self._left is not None:
                self._left -= 1
        self._task = self._kept = None
        if hold and self._leads():
            with suppress(RcpError):
                await self._motion.shielded(self._motion.hold)

    def end(self) -> None:
        """Stop sending."""
        for task in (self._task, self._entering):
            if task is not None:
                task.cancel()
        self._task = self._entering = None
        self._kept = None


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
