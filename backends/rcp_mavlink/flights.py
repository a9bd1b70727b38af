"""Take-off, return and landing: completed when telemetry confirms it, with progress."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from typing import Any

from rcp_kernel.errors import PreconditionFailed
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.geo import distance
from rcp_mavlink.journeys import Journeys, holding
from rcp_mavlink.motion import Motion, unanswered
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.places import fix_of, located, part, reach
from rcp_mavlink.restart import one_boot
from rcp_mavlink.vehicle import Fix, Vehicle

__all__ = ["Flights"]

_HOME = 5.0  # m from home within which a ground vehicle has returned


class Flights:
    """Flights of one vehicle."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: Commands,
        motion: Motion,
        parameters: Parameters,
        journeys: Journeys,
    ) -> None:
        self._vehicle, self._commands = vehicle, commands
        self._motion, self._parameters = motion, parameters
        self._journeys = journeys

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {
            "action/takeoff": self.take_off,
            "action/land": self.land,
            "action/rtl": self.rtl,
            "action/return_home": self.rtl,
            "action/move_to": self._journeys.move_to,
        }

    def foresee(self, name: str, value: Any) -> None:
        """Refuse what would be refused now.

        :raises RcpError: as the handler of the path.
        """
        match name:
            case "action/move_to":
                self._journeys.foresee(value)
            case "action/takeoff":
                self._check_on_ground()
            case "action/land" | "action/rtl" | "action/return_home":
                self._check_not_down(name.rpartition("/")[2])
            case _:
                pass

    async def keep_limit(self) -> None:
        """Keep to a changed speed limit from here on.

        :raises RcpError: the vehicle does not change the speed of its flight.
        """
        await self._journeys.keep_limit()

    # Take-off

    async def take_off(self, given: m.TakeOff | None, progress: Progress) -> m.Height:
        """Climb to a height above home."""
        vehicle, altitude = self._vehicle, (given or m.TakeOff()).altitude
        self._check_on_ground()
        start = (await located(vehicle)).height
        async with holding(self._motion):

            def report() -> bool:
                now = fix_of(vehicle).height
                progress(m.Height(now), fraction=part(now - start, altitude - start))
                aloft = vehicle.landed is not True  # it is told less often than the height
                return aloft and now >= altitude - max(0.3, 0.03 * altitude)

            with unanswered(report):
                await self._rise(altitude)
            await self._motion.follow(report, "take-off", stays=lambda: vehicle.armed)
        return m.Height(fix_of(vehicle).height)

    def _check_on_ground(self) -> None:
        if not self._vehicle.armed:
            raise PreconditionFailed("take-off: the vehicle is not armed", remedy="Arm it first.")
        if self._vehicle.landed is False:
            raise PreconditionFailed(
                "take-off: the vehicle is in the air", remedy="Use action/move_to to climb."
            )

    async def _rise(self, altitude: float) -> None:
        family = self._vehicle.family
        if family.px4:
            fix = fix_of(self._vehicle)
            height = altitude + fix.above_sea - fix.height
            nan = math.nan  # the present position and heading
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

    # Return and landing

    async def land(self, _: None, progress: Progress) -> m.Height:
        """Land at the current position."""
        return await self._come_down(self._vehicle.family.land, "land", progress)

    async def rtl(self, _: None, progress: Progress) -> m.Height:
        """Return home: a copter lands there, a plane circles, a rover stops."""
        return await self._come_down(self._vehicle.family.rtl, "return", progress)

    async def _come_down(self, mode: str, what: str, progress: Progress) -> m.Height:
        vehicle, family = self._vehicle, self._vehicle.family
        self._check_not_down(what)
        first = self._left(await located(vehicle), what)
        near = 0.0
        if what == "return" and family.kind != "copter":
            near = reach(vehicle, self._parameters, _HOME)
        measurement = self._motion.measurement
        async with holding(self._motion), one_boot(vehicle, self._commands, what) as boot:

            def report() -> bool:
                now = fix_of(vehicle)
                left = self._left(now, what)
                feedback = m.OnItsWay(left, now.height, vehicle.mode)
                progress(feedback, fraction=part(first - left, first))
                down = measurement.standing and measurement.disarmed
                return down or self._from_home(now) < near

            with unanswered(report):
                await self._motion.to_mode(mode)

            def stays() -> bool:
                return vehicle.mode == mode and not boot.began_again

            await self._motion.follow(report, what, stays=stays)
        return m.Height(fix_of(vehicle).height)

    def _check_not_down(self, what: str) -> None:
        measurement = self._motion.measurement
        if self._vehicle.family.flies and measurement.standing and measurement.disarmed:
            raise PreconditionFailed(f"{what}: the vehicle is already on the ground")

    def _from_home(self, fix: Fix) -> float:
        home = self._vehicle.home
        return math.inf if home is None else distance((fix.lat, fix.lon), home[:2])

    def _left(self, fix: Fix, what: str) -> float:
        """Return the remaining distance; never 0, because it is a divisor."""
        away = self._from_home(fix) if what == "return" else 0.0
        return max(0.1, math.hypot(0.0 if math.isinf(away) else away, fix.height))
