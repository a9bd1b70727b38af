"""Taking off, going somewhere, coming back, landing: done when telemetry shows it, told meanwhile."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from rcp_kernel.errors import InvalidValue, PreconditionFailed
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.geo import distance, shifted
from rcp_mavlink.motion import Motion
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.vehicle import Fix, Vehicle

__all__ = ["Flights"]

_CHANGE_MODE = 1.0
_RELATIVE, _ABSOLUTE = 6, 5
_LOOKING = 3.0  # s
_HOME = 5.0  # m from home that count as there, for what drives
_CIRCLE = 80.0  # m of radius, of a plane that does not say
_RADII = ("WP_LOITER_RAD", "NAV_LOITER_RAD")
_ROUND = 1.5  # radii off the place it circles round that count as there
_LEVEL = 10.0  # m over or under it, for a plane


class Flights:
    """Where one vehicle is told to go."""

    def __init__(
        self, vehicle: Vehicle, commands: Commands, motion: Motion, parameters: Parameters
    ) -> None:
        self._vehicle, self._commands = vehicle, commands
        self._motion, self._parameters = motion, parameters

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return what each path runs."""
        return {
            "action/takeoff": self.take_off,
            "action/land": self.land,
            "action/rtl": self.rtl,
            "action/move_to": self.move_to,
        }

    @asynccontextmanager
    async def _holding(self) -> AsyncGenerator[None]:
        """Have it hold where it is when the command is cancelled."""
        try:
            yield
        except asyncio.CancelledError:
            await self._motion.shielded(self._motion.hold)
            raise

    # Up

    async def take_off(self, given: m.TakeOff | None, progress: Progress) -> m.Height:
        """Rise to a height over home."""
        vehicle, altitude = self._vehicle, (given or m.TakeOff()).altitude
        if not vehicle.armed:
            raise PreconditionFailed("take-off: the vehicle is not armed", remedy="Arm it first.")
        if vehicle.landed is False:
            raise PreconditionFailed(
                "take-off: the vehicle is in the air", remedy="Use action/move_to to climb."
            )
        start = (await self._located()).height
        async with self._holding():
            await self._rise(altitude)

            def tell() -> bool:
                now = self._fix().height
                progress(m.Height(now), fraction=_part(now - start, altitude - start))
                return now >= altitude - max(0.3, 0.03 * altitude)

            await self._motion.follow(tell, "take-off", stays=lambda: vehicle.armed)
        return m.Height(self._fix().height)

    async def _rise(self, altitude: float) -> None:
        family = self._vehicle.family
        if family.px4:
            height = altitude + self._fix().above_sea - self._fix().height
            nan = math.nan  # the heading and the place it has
            command = Command(22, (0.0, 0.0, 0.0, nan), nan, nan, height)
        elif family.kind == "plane":
            known = self._parameters.known.get("TKOFF_ALT")
            if known is not None and known.value != altitude:
                await self._parameters.write("TKOFF_ALT", altitude)
            await self._motion.to_mode("TAKEOFF")
            return
        else:
            await self._motion.to_mode(family.guided)
            command = Command(22, z=altitude)
        await self._commands.send(command, "take-off")

    # Back

    async def land(self, _: None, progress: Progress) -> m.Height:
        """Come down where it is."""
        return await self._come_down(self._vehicle.family.land, "land", progress)

    async def rtl(self, _: None, progress: Progress) -> m.Height:
        """Come home: a copter lands there, a plane circles, a rover stops."""
        return await self._come_down(self._vehicle.family.rtl, "return", progress)

    async def _come_down(self, mode: str, what: str, progress: Progress) -> m.Height:
        vehicle, family = self._vehicle, self._vehicle.family
        if vehicle.landed and not vehicle.armed and family.flies:
            raise PreconditionFailed(f"{what}: the vehicle stands on the ground already")
        first = self._left(await self._located(), what)
        near = 0.0
        if what == "return" and family.kind != "copter":
            near = self._reach(_HOME)
        async with self._holding():
            await self._motion.to_mode(mode)

            def tell() -> bool:
                now = self._fix()
                left = self._left(now, what)
                told = m.OnItsWay(left, now.height, vehicle.mode)
                progress(told, fraction=_part(first - left, first))
                down = vehicle.landed is True and not vehicle.armed
                return down or self._from_home(now) < near

            await self._motion.follow(tell, what, stays=lambda: vehicle.mode == mode)
        return m.Height(self._fix().height)

    def _from_home(self, fix: Fix) -> float:
        home = self._vehicle.home
        return math.inf if home is None else distance((fix.lat, fix.lon), home[:2])

    def _left(self, fix: Fix, what: str) -> float:
        """Return how far it still has to go; never 0, because parts are made of it."""
        away = self._from_home(fix) if what == "return" else 0.0
        return max(0.1, math.hypot(0.0 if math.isinf(away) else away, fix.height))

    # There

    async def move_to(self, goal: m.MoveTo, progress: Progress) -> m.Arrived:
        """Go to a place and stay there; a plane circles round it."""
        vehicle, fix, family = self._vehicle, await self._located(), self._vehicle.family
        if family.flies and vehicle.landed is not False:
            raise PreconditionFailed(
                "move_to: the vehicle is not in the air", remedy="Arm it and take off first."
            )
        if family.drives and not vehicle.armed:
            raise PreconditionFailed("move_to: the vehicle is not armed", remedy="Arm it first.")
        lat, lon = self._place(goal, fix)
        altitude = fix.height if goal.altitude is None or family.drives else goal.altitude
        way = max(self._away(fix, lat, lon, altitude), 0.1)
        async with self._holding():
            since = time.monotonic()
            await self._commands.send(self._reposition(goal, fix, lat, lon, altitude), "move_to")
            guided = family.guided
            await self._motion.seen(lambda: vehicle.mode == guided, "move_to")

            def tell() -> bool:
                now = self._fix()
                left = self._away(now, lat, lon, altitude)
                progress(
                    m.OnItsWay(left, now.height, vehicle.mode), fraction=_part(way - left, way)
                )
                fresh = vehicle.came["GLOBAL_POSITION_INT"] > since
                return fresh and self._arrived(now, lat, lon, altitude, goal.tolerance)

            await self._motion.follow(tell, "move_to", stays=lambda: vehicle.mode == guided)
        now = self._fix()
        return m.Arrived(now.lat, now.lon, now.height, self._away(now, lat, lon, altitude))

    def _reposition(
        self, goal: m.MoveTo, fix: Fix, lat: float, lon: float, altitude: float
    ) -> Command:
        px4 = self._vehicle.family.px4
        speed = -1.0 if goal.speed is None else goal.speed
        # PX4 keeps its heading for NaN, which ArduPilot must not be given.
        yaw = goal.yaw if goal.yaw is not None else math.nan if px4 else 0.0
        height, frame = altitude, _RELATIVE
        if px4:
            height, frame = altitude + fix.above_sea - fix.height, _ABSOLUTE
        params = (speed, _CHANGE_MODE, 0.0, yaw)
        return Command(192, params, lat, lon, height, frame, place=True, whole=True)

    def _arrived(self, fix: Fix, lat: float, lon: float, altitude: float, near: float) -> bool:
        if not self._vehicle.family.circles:
            return self._away(fix, lat, lon, altitude) <= near
        level = abs(fix.height - altitude) <= max(near, _LEVEL)
        return level and distance((fix.lat, fix.lon), (lat, lon)) <= self._reach(near)

    def _reach(self, near: float) -> float:
        """Return how far off a place counts as there, m."""
        if not self._vehicle.family.circles:
            return near
        known = (self._parameters.known.get(name) for name in _RADII)
        radius = next((abs(p.value) for p in known if p is not None and p.value), _CIRCLE)
        return max(near, radius * _ROUND)

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

    def _away(self, fix: Fix, lat: float, lon: float, altitude: float) -> float:
        flat = distance((fix.lat, fix.lon), (lat, lon))
        return flat if self._vehicle.family.drives else math.hypot(flat, fix.height - altitude)

    async def _located(self) -> Fix:
        """Return where it is, after what was asked for a moment before has come."""
        await self._vehicle.until(lambda: self._vehicle.fix is not None, _LOOKING)
        return self._fix()

    def _fix(self) -> Fix:
        fix = self._vehicle.fix
        if fix is None:
            raise PreconditionFailed(
                "the vehicle does not know where it is", remedy="Wait for GPS: see sensor/gps."
            )
        return fix


def _part(done: float, whole: float) -> float:
    return min(1.0, max(0.0, done / whole)) if whole > 0 else 1.0
