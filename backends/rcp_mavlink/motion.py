"""What moves a vehicle: each is done when telemetry shows it, and not when it is acknowledged."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from rcp_kernel.errors import (
    DeviceRejected,
    DeviceTimeout,
    InvalidValue,
    NotImplementedByRobot,
    PreconditionFailed,
    RcpError,
)
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.geo import distance, shifted
from rcp_mavlink.vehicle import Fix, Vehicle

__all__ = ["Motion"]

_FORCE = 21196.0
_CHANGE_MODE = 1.0
_SETTLE = 3.0  # s for the telemetry to show what was accepted
_FEEDBACK = 0.25  # s
_RELATIVE, _ABSOLUTE = 6, 5
_AT_REST = 0.35  # m/s
_STOPPING = 15.0  # s in which it has come to rest
_HOLDING = 3.0  # s for a hold to be accepted after a cancel


class Motion:
    """Arming, taking off, going, coming back, landing, holding."""

    def __init__(self, vehicle: Vehicle, commands: Commands) -> None:
        self._vehicle, self._commands = vehicle, commands
        self.parting: set[asyncio.Future[Any]] = set()
        """What cancelled commands still do."""

    # Arming and modes

    async def arm(self, given: m.Arm | None, progress: Progress) -> m.Armed:
        """Start the motors."""
        try:
            await self._arm(on=True, force=given is not None and given.force)
        except asyncio.CancelledError:
            await self.shielded(lambda: self._arm(on=False, force=False))
            raise
        return m.Armed(self._vehicle.armed, self._vehicle.mode)

    async def disarm(self, given: m.Arm | None, progress: Progress) -> m.Armed:
        """Stop the motors."""
        await self._arm(on=False, force=given is not None and given.force)
        return m.Armed(self._vehicle.armed, self._vehicle.mode)

    async def _arm(self, *, on: bool, force: bool) -> None:
        what = "arm" if on else "disarm"
        params = (float(on), _FORCE if force else 0.0, 0.0, 0.0)
        await self._commands.send(Command(400, params), what)
        await self._seen(lambda: self._vehicle.armed == on, what)

    async def set_mode(self, given: m.SetMode, progress: Progress) -> m.SetMode:
        """Change the flight mode."""
        name = given.mode.upper()
        modes = self._vehicle.family.modes.values()
        if name not in modes:
            raise InvalidValue(
                f"the vehicle has no mode {given.mode}",
                remedy=f"Its modes: {', '.join(modes)}.",
                details={"pointer": "/mode"},
            )
        await self.to_mode(name)
        return m.SetMode(self._vehicle.mode)

    async def to_mode(self, name: str) -> None:
        """Bring the vehicle into a mode of its family."""
        family = self._vehicle.family
        number = family.number(name)
        if number is None:
            raise NotImplementedByRobot(f"a {family.kind} has no mode {name or 'for that'}")
        if self._vehicle.mode_number == number:
            return
        params = (1.0, float(number), 0.0, 0.0)
        if family.px4:
            params = (1.0, float(number >> 16 & 0xFF), float(number >> 24 & 0xFF), 0.0)
        await self._commands.send(Command(176, params), f"mode {name}")
        await self._seen(lambda: self._vehicle.mode_number == number, f"mode {name}")

    async def _seen(self, holds: Callable[[], bool], what: str) -> None:
        if not holds():  # a heartbeat comes once a second, and sooner if it is asked for
            with suppress(DeviceRejected, DeviceTimeout):
                await self._commands.send(Command(512), "request of HEARTBEAT")
        if not await self._vehicle.until(holds, _SETTLE):
            raise DeviceTimeout(f"{what}: accepted, but the vehicle does not show it")

    # Flying

    async def take_off(self, given: m.TakeOff | None, progress: Progress) -> m.Height:
        """Rise to a height over home."""
        vehicle, altitude = self._vehicle, (given or m.TakeOff()).altitude
        if not vehicle.armed:
            raise PreconditionFailed("take-off: the vehicle is not armed", remedy="Arm it first.")
        if vehicle.landed is False:
            raise PreconditionFailed(
                "take-off: the vehicle is in the air", remedy="Use action/move_to to climb."
            )
        height = altitude
        if vehicle.family.px4:
            height += (vehicle.home or (0.0, 0.0, 0.0))[2]
        elif vehicle.mode != vehicle.family.guided:
            await self.to_mode(vehicle.family.guided)
        start = self._fix().height
        try:
            await self._commands.send(
                Command(22, (0.0, 0.0, 0.0, math.nan if vehicle.family.px4 else 0.0), z=height,
                        x=math.nan if vehicle.family.px4 else 0.0,
                        y=math.nan if vehicle.family.px4 else 0.0),
                "take-off",
            )  # fmt: skip

            def tell() -> bool:
                now = self._fix().height
                progress(m.Height(now), fraction=_part(now - start, altitude - start))
                return now >= altitude - max(0.3, 0.03 * altitude)

            await self.follow(tell, "take-off", stays=lambda: vehicle.armed)
        except asyncio.CancelledError:
            await self.shielded(self.hold)
            raise
        return m.Height(self._fix().height)

    async def land(self, _: None, progress: Progress) -> m.Height:
        """Come down where it is."""
        return await self._come_down(Command(21), "land", progress)

    async def rtl(self, _: None, progress: Progress) -> m.Height:
        """Fly home and land."""
        return await self._come_down(Command(20), "return", progress)

    async def _come_down(self, command: Command, what: str, progress: Progress) -> m.Height:
        vehicle = self._vehicle
        if vehicle.landed and not vehicle.armed:
            raise PreconditionFailed(f"{what}: the vehicle stands on the ground already")
        start = max(self._fix().height, 0.1)
        try:
            before = vehicle.mode_number
            await self._commands.send(command, what)
            await self._seen(lambda: vehicle.mode_number != before or _coming(vehicle, what), what)
            mode = vehicle.mode_number

            def tell() -> bool:
                now = self._fix()
                progress(
                    self._on_its_way(now, vehicle.home), fraction=_part(start - now.height, start)
                )
                return vehicle.landed is True and not vehicle.armed

            await self.follow(tell, what, stays=lambda: vehicle.mode_number == mode)
        except asyncio.CancelledError:
            await self.shielded(self.hold)
            raise
        return m.Height(self._fix().height)

    async def move_to(self, goal: m.MoveTo, progress: Progress) -> m.Arrived:
        """Go to a place and stay there."""
        vehicle, fix = self._vehicle, self._fix()
        if vehicle.landed is not False and vehicle.family.kind in ("copter", "px4"):
            raise PreconditionFailed(
                "move_to: the vehicle is not in the air", remedy="Arm it and take off first."
            )
        lat, lon = self._place(goal, fix)
        altitude = fix.height if goal.altitude is None else goal.altitude
        way = max(self._away(fix, lat, lon, altitude), 0.1)
        speed = -1.0 if goal.speed is None else goal.speed
        yaw = math.nan if goal.yaw is None else goal.yaw
        height, frame = altitude, _RELATIVE
        if vehicle.family.px4:
            height, frame = altitude + fix.above_sea - fix.height, _ABSOLUTE
        if not vehicle.family.px4 and goal.yaw is None:
            yaw = 0.0
        command = Command(
            192, (speed, _CHANGE_MODE, 0.0, yaw), lat, lon, height, frame, place=True, whole=True
        )
        try:
            await self._commands.send(command, "move_to")
            guided = vehicle.family.guided
            await self._seen(lambda: vehicle.mode == guided, "move_to")

            def tell() -> bool:
                now = self._fix()
                left = self._away(now, lat, lon, altitude)
                progress(
                    m.OnItsWay(left, now.height, vehicle.mode), fraction=_part(way - left, way)
                )
                return left <= goal.tolerance

            await self.follow(tell, "move_to", stays=lambda: vehicle.mode == guided)
        except asyncio.CancelledError:
            await self.shielded(self.hold)
            raise
        now = self._fix()
        return m.Arrived(now.lat, now.lon, now.height, self._away(now, lat, lon, altitude))

    def _place(self, goal: m.MoveTo, fix: Fix) -> tuple[float, float]:
        metres = goal.north is not None or goal.east is not None
        degrees = goal.latitude is not None or goal.longitude is not None
        if metres and degrees:
            raise InvalidValue("give latitude and longitude, or north and east, not both")
        if degrees:
            if goal.latitude is None or goal.longitude is None:
                raise InvalidValue("latitude and longitude go together")
            return goal.latitude, goal.longitude
        if not metres:
            return fix.lat, fix.lon
        home = self._vehicle.home
        if home is None:
            raise PreconditionFailed("move_to: home is not known yet")
        return shifted(goal.north or 0.0, goal.east or 0.0, home[:2])

    @staticmethod
    def _away(fix: Fix, lat: float, lon: float, altitude: float) -> float:
        return math.hypot(distance((fix.lat, fix.lon), (lat, lon)), fix.height - altitude)

    @staticmethod
    def _on_its_way(fix: Fix, home: tuple[float, float, float] | None) -> m.OnItsWay:
        away = 0.0 if home is None else distance((fix.lat, fix.lon), home[:2])
        return m.OnItsWay(math.hypot(away, fix.height), fix.height, "")

    def _fix(self) -> Fix:
        fix = self._vehicle.fix
        if fix is None:
            raise PreconditionFailed(
                "the vehicle does not know where it is", remedy="Wait for GPS: see sensor/gps."
            )
        return fix

    async def follow(self, tell: Callable[[], bool], what: str, stays: Callable[[], bool]) -> None:
        """Wait for `tell`, which reports, and see that the vehicle stays at it.

        :raises DeviceRejected: it does something else, with what it said meanwhile.
        """
        began = time.monotonic()
        told, done = 0.0, False

        def look() -> bool:
            nonlocal told, done
            if (now := time.monotonic()) - told >= _FEEDBACK:
                told = now
                done = tell()
            else:
                done = False
            return done or not stays()

        await self._vehicle.until(look)
        if done or tell():
            return
        reasons = self._vehicle.texts_since(began, severity=4)
        said = f": {'; '.join(reasons[-3:])}" if reasons else ""
        raise DeviceRejected(
            f"{what}: the vehicle left it for mode {self._vehicle.mode}{said}",
            details={"mode": self._vehicle.mode, "texts": reasons},
        )

    # Coming to rest

    @property
    def rests(self) -> bool:
        """Whether it does not move."""
        fix = self._vehicle.fix
        landed = self._vehicle.landed is True
        return not self._vehicle.armed or landed or (fix is not None and fix.speed < _AT_REST)

    async def hold(self) -> None:
        """Come to rest where it is and stay."""
        vehicle = self._vehicle
        if vehicle.armed and vehicle.landed is not True:
            await self.to_mode(vehicle.family.hold)

    async def halt(self, policy: str) -> None:
        """Bring it to rest, the way the e-stop's policy says; return when that is seen."""
        vehicle = self._vehicle
        if not vehicle.armed:
            return
        if policy == "disarm" or vehicle.landed is True:
            await self._arm(on=False, force=policy == "disarm")
            return
        if policy == "land" and vehicle.family.land:
            await self._commands.send(Command(21), "land")
            await self._seen(lambda: _coming(vehicle, "land"), "land")
            return
        await self.hold()
        if not await vehicle.until(lambda: self.rests, _STOPPING):
            raise DeviceTimeout("the vehicle was told to hold and still moves")

    async def shielded(self, do: Callable[[], Awaitable[Any]]) -> None:
        """Do it although the command that asks is being cancelled."""
        task = asyncio.ensure_future(do())
        self.parting.add(task)
        task.add_done_callback(self.parting.discard)
        with suppress(RcpError, TimeoutError):
            async with asyncio.timeout(_HOLDING):
                await asyncio.shield(task)


def _coming(vehicle: Vehicle, what: str) -> bool:
    word = "RTL" if what == "return" else vehicle.family.land
    return vehicle.mode == word


def _part(done: float, whole: float) -> float:
    return min(1.0, max(0.0, done / whole)) if whole > 0 else 1.0
