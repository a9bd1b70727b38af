"""Flights to a target with speed and heading, verified by telemetry."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Generator
from contextlib import asynccontextmanager, contextmanager

from msgspec.structs import replace

from rcp_kernel.errors import (
    DeviceRejected,
    DeviceTimeout,
    InvalidValue,
    OutOfRange,
    PreconditionFailed,
    RcpError,
)
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.fences import beyond, crossing, is_breached
from rcp_mavlink.geo import distance
from rcp_mavlink.motion import Motion, unanswered
from rcp_mavlink.pace import Pace
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.places import (
    away,
    fix_of,
    located,
    native_goal,
    part,
    place_of,
    pose_of,
    reach,
)
from rcp_mavlink.speeds import SpeedLimit
from rcp_mavlink.terrain import Terrain, check_offered
from rcp_mavlink.vehicle import Fix, Vehicle

__all__ = ["Journeys", "hold_after", "holding"]

_CHANGE_MODE = 1.0
_RELATIVE, _ABSOLUTE, _TERRAIN = 6, 5, 11
_REPOSITION, _CHANGE_SPEED, _CONDITION_YAW = 192, 178, 115
_AIRSPEED, _GROUNDSPEED = 0.0, 1.0
_LEVEL = 10.0  # m of height tolerance, for a plane
_STANDING = 0.2  # m/s below which the time left is unknown
_HOME_TIMEOUT = 3.0  # s
_FENCED = (
    "Choose a target inside the fence: see service/fence/download, param/FENCE_* or param/GF_*."
)
_IGNORED = "Reposition is outside geofence"  # PX4's own text


class Journeys:
    """Flights of one vehicle to targets."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: Commands,
        motion: Motion,
        parameters: Parameters,
        limit: SpeedLimit,
        terrain: Terrain,
    ) -> None:
        self._vehicle, self._commands = vehicle, commands
        self._terrain = terrain
        self._motion, self._parameters, self._limit = motion, parameters, limit
        self._paced = False
        """Whether the speed of an earlier flight may still be in effect."""
        self._under_way: Callable[[], Awaitable[None]] | None = None
        """Makes the flight under way keep to a changed speed limit."""

    async def move_to(self, goal: m.MoveTo, progress: Progress) -> m.Arrived:
        """Go to a target and stay there; a plane circles around it."""
        vehicle = self._vehicle
        profiled = goal.position is not None
        fix = await located(vehicle)
        if not await vehicle.until(lambda: vehicle.home is not None, _HOME_TIMEOUT):
            raise PreconditionFailed("move_to: home is not known yet")
        goal, (lat, lon), altitude = self._target(goal, fix)
        if goal.above == "terrain":
            altitude = await self._terrain.above_home(lat, lon, altitude)
            fix = fix_of(vehicle)  # it may have moved meanwhile
            self._target(goal, fix)
        if vehicle.family.px4:  # it would accept the target, and ignore it
            self._check_fence((lat, lon), altitude)
        distance = max(away(vehicle, fix, lat, lon, altitude), 0.1)
        wanted, limit = goal.speed, self._limit.usual

        def allowed() -> float | None:
            return None if wanted is None else self._limit.kept(wanted, strictly=profiled)

        goal = replace(goal, speed=allowed())
        pace = Pace(vehicle, goal.speed, goal.yaw)
        near = goal.tolerance or 0.0

        def report() -> bool:
            now = fix_of(vehicle)
            left = away(vehicle, now, lat, lon, altitude)
            eta = left / now.speed if now.speed > _STANDING else None
            feedback = m.Underway(left, now.height, vehicle.mode, left, eta)
            progress(feedback, fraction=part(distance - left, distance))
            fresh = vehicle.received_at["GLOBAL_POSITION_INT"] > since
            there = fresh and self._arrived(now, lat, lon, altitude, near)
            return pace.update(there=there)

        async def keep_limit() -> None:
            nonlocal limit, goal
            speed, usual = allowed(), self._limit.usual
            if usual == limit or (wanted is not None and speed == goal.speed):
                return
            limit, goal = usual, replace(goal, speed=speed)
            pace.request(speed)
            await self._change_speed(usual if speed is None else speed)

        async with holding(self._motion):
            with unanswered(progress):
                await self._prepare(goal, fix)
            since = time.monotonic()
            async with self._stopping(DeviceTimeout):  # it may have been accepted
                with self._explained((lat, lon), altitude), unanswered(report):
                    await self._go(goal, fix, lat, lon, altitude)
            report()  # it moves from here on, so a lost link no longer means a refusal
            async with self._stopping(RcpError), self.limited(keep_limit):
                await self._follow(goal, pace, report, since)
        now = fix_of(vehicle)
        error = away(vehicle, now, lat, lon, altitude)
        pose = pose_of(vehicle, now, pace.heading)
        return m.Arrived(pose, now.lat, now.lon, now.height, error, pace.fastest, pace.heading)

    def foresee(self, goal: m.MoveTo) -> None:
        """Refuse a goal that the vehicle would refuse now, as far as the gateway knows.

        :raises RcpError: as `move_to`.
        """
        fix = fix_of(self._vehicle)
        goal, place, altitude = self._target(goal, fix)
        if goal.above == "terrain":  # only the vehicle knows how high that is
            altitude = fix.height
        self._check_fence(place, altitude)

    def _check_fence(self, place: tuple[float, float], altitude: float) -> None:
        if (why := beyond(self._vehicle, self._parameters, place, altitude)) is not None:
            raise DeviceRejected(f"move_to: {why}", remedy=_FENCED, details={"fence": why})

    def _target(self, goal: m.MoveTo, fix: Fix) -> tuple[m.MoveTo, tuple[float, float], float]:
        """Return a goal as the vehicle takes it: latitude and longitude (deg), and height (m).

        :raises RcpError: it cannot go there now.
        """
        vehicle, family = self._vehicle, self._vehicle.family
        goal = native_goal(vehicle, goal)
        if family.flies and vehicle.landed is not False:
            raise PreconditionFailed(
                "move_to: the vehicle is not in the air", remedy="Arm it and take off first."
            )
        if family.drives and not vehicle.armed:
            raise PreconditionFailed("move_to: the vehicle is not armed", remedy="Arm it first.")
        self._check(goal)
        altitude = fix.height if goal.altitude is None or family.drives else goal.altitude
        return goal, place_of(vehicle, goal, fix), altitude

    async def keep_limit(self) -> None:
        """Have the flight under way keep to a changed speed limit.

        :raises RcpError: the vehicle does not change its speed.
        """
        if self._under_way is not None:
            await self._under_way()

    @asynccontextmanager
    async def limited(self, keep_limit: Callable[[], Awaitable[None]]) -> AsyncGenerator[None]:
        """Keep to the speed limit while entered; it may have changed just before."""
        self._under_way = keep_limit
        try:
            await keep_limit()
            yield
        finally:
            if self._under_way is keep_limit:
                self._under_way = None

    async def _follow(
        self, goal: m.MoveTo, pace: Pace, report: Callable[[], bool], since: float
    ) -> None:
        """Wait until it arrives; abort if it deviates from the request."""
        vehicle, guided = self._vehicle, self._vehicle.family.guided
        if goal.yaw is not None and not vehicle.family.px4:
            await self._turn(goal.yaw)  # a new target makes it face its direction of travel
        await self._motion.seen(lambda: vehicle.mode == guided, "move_to")

        def stays() -> bool:
            return vehicle.mode == guided and pace.fault is None and not self._is_ignored(since)

        try:
            await self._motion.follow(report, "move_to", stays=stays)
        except DeviceRejected as error:
            if self._is_ignored(since):
                raise DeviceRejected(
                    f"move_to: the vehicle stays where it is: {_IGNORED}",
                    remedy=_FENCED,
                    details={**(error.details or {}), "fence": _IGNORED},
                ) from None
            raise self._failure(pace, error) from None

    def _is_ignored(self, since: float) -> bool:
        """Return whether a PX4, which accepts any target, has said that it ignores this one."""
        texts = self._vehicle.texts_since(since) if self._vehicle.family.px4 else ()
        return any(_IGNORED in text for text in texts)

    def _check(self, goal: m.MoveTo) -> None:
        """Refuse what the vehicle cannot do, before anything moves.

        :raises InvalidValue: it accepts no yaw, or cannot fly at that speed.
        """
        family = self._vehicle.family
        if goal.above == "terrain":
            self._check_height(goal)
        if goal.yaw is not None and (family.drives or family.circles):
            raise InvalidValue(
                f"move_to: a {family.kind} faces its direction of travel and accepts no yaw",
                remedy="Remove `yaw`.",
                details={"pointer": "/yaw"},
            )
        if goal.speed is not None and family.circles and not family.px4:
            least, most = self._limit.airspeeds
            if not least <= goal.speed <= most:
                raise OutOfRange(
                    f"move_to: its airspeed range is {least:g} to {most:g} m/s, not {goal.speed:g}",
                    details={"pointer": "/speed"},
                )

    def _check_height(self, goal: m.MoveTo) -> None:
        if self._vehicle.family.drives or goal.altitude is None:
            why = "needs an altitude" if goal.altitude is None else "is not for ground vehicles"
            raise InvalidValue(
                f"move_to: a height above the ground {why}",
                remedy="Give `altitude`, or leave `above` out.",
                details={"pointer": "/above"},
            )
        check_offered(self._vehicle, "move_to")

    # Commands

    async def _prepare(self, goal: m.MoveTo, fix: Fix) -> None:
        """Set speed and heading on an ArduPilot, while the vehicle stays where it is.

        ArduPilot ignores both in DO_REPOSITION and resets them when it enters GUIDED. So the
        vehicle first enters it at its present location; if it refuses, it does so at rest.
        """
        vehicle, family = self._vehicle, self._vehicle.family
        if family.px4:
            return
        self._paced = self._paced and vehicle.mode == family.guided
        # A new limit in the parameters may not apply to the present mode.
        own = self._paced or self._limit.was_set
        speed = self._limit.usual if goal.speed is None and own else goal.speed
        if speed is None and goal.yaw is None:
            return
        if family.circles:
            await self._motion.to_mode(family.guided, surely=True)
        else:
            with self._explained((fix.lat, fix.lon), fix.height):
                await self._reposition(fix.lat, fix.lon, fix.height)
            await self._motion.seen(lambda: vehicle.mode == family.guided, "move_to")
        if speed is not None:
            await self._change_speed(speed)
            self._paced = goal.speed is not None
        if goal.yaw is not None:
            await self._turn(goal.yaw)

    async def _change_speed(self, speed: float | None) -> None:
        """Set the speed of the present flight; PX4 reads its parameter all the time."""
        family = self._vehicle.family
        if family.px4 or speed is None:
            return
        kind = _AIRSPEED if family.circles else _GROUNDSPEED
        command = Command(_CHANGE_SPEED, (kind, speed, -1.0, 0.0))
        await self._commands.send(command, f"move_to: speed {speed:g} m/s")

    async def _turn(self, yaw: float) -> None:
        """Turn to a heading, rad clockwise from north; the command takes 0 to 360 deg."""
        degrees = math.degrees(yaw) % 360
        await self._commands.send(Command(_CONDITION_YAW, (degrees, 0.0, 0.0, 0.0)), "move_to: yaw")

    async def _go(self, goal: m.MoveTo, fix: Fix, lat: float, lon: float, altitude: float) -> None:
        if goal.above == "terrain":
            await self._reposition(lat, lon, goal.altitude or 0.0, frame=_TERRAIN)
            return
        if not self._vehicle.family.px4:
            await self._reposition(lat, lon, altitude)
            return
        speed = -1.0 if goal.speed is None else goal.speed
        yaw = math.nan if goal.yaw is None else goal.yaw  # NaN: keep the present heading
        height = altitude + fix.above_sea - fix.height
        await self._reposition(lat, lon, height, speed, yaw, _ABSOLUTE)

    async def _reposition(
        self, lat: float, lon: float, height: float, speed: float = -1.0, yaw: float = 0.0, frame: int = _RELATIVE
    ) -> None:  # fmt: skip
        params = (speed, _CHANGE_MODE, 0.0, yaw)
        command = Command(_REPOSITION, params, lat, lon, height, frame, place=True, whole=True)
        await self._commands.send(command, "move_to")

    def _arrived(self, fix: Fix, lat: float, lon: float, altitude: float, near: float) -> bool:
        vehicle = self._vehicle
        if not vehicle.family.circles:
            return away(vehicle, fix, lat, lon, altitude) <= near
        level = abs(fix.height - altitude) <= max(near, _LEVEL)
        flat = distance((fix.lat, fix.lon), (lat, lon))
        return level and flat <= reach(vehicle, self._parameters, near)

    # Failures

    @asynccontextmanager
    async def _stopping(self, of: type[RcpError]) -> AsyncGenerator[None]:
        """Command a hold if the flight fails while the vehicle is still in the mode for it.

        Not after another mode has taken over: a failsafe or a pilot is then in control.
        """
        try:
            yield
        except of as error:
            if self._vehicle.mode == self._vehicle.family.guided and not self._vehicle.lost:
                await hold_after(self._motion, error)
            raise

    @contextmanager
    def _explained(self, place: tuple[float, float], height: float) -> Generator[None]:
        """Name the fence that explains a refusal without a text."""
        try:
            yield
        except DeviceRejected as error:
            known = error.details or {}
            silent = not known.get("texts")
            why = crossing(self._vehicle, self._parameters, place, height) if silent else None
            if why is None:
                raise
            raise DeviceRejected(
                f"{error}: {why}",
                remedy=_FENCED,
                details={**known, "fence": why},
            ) from None

    def _failure(self, pace: Pace, error: DeviceRejected) -> DeviceRejected:
        """Return the error for a flight that ended early."""
        if pace.fault is not None:
            return DeviceRejected(
                f"move_to: {pace.fault}; the vehicle was commanded to hold", details=error.details
            )
        if is_breached(self._vehicle) and "fence" not in str(error).lower():
            return DeviceRejected(
                f"{error}: the vehicle is outside its fence", details=error.details
            )
        return error


@asynccontextmanager
async def holding(motion: Motion) -> AsyncGenerator[None]:
    """Hold the position when the command is cancelled."""
    try:
        yield
    except asyncio.CancelledError:
        await motion.shielded(motion.hold)
        raise


async def hold_after(motion: Motion, error: RcpError) -> None:
    """Command a hold after a failure.

    :raises DeviceTimeout: it is not confirmed: the vehicle may go on, although the error may say that it holds.
    """
    try:
        await motion.shielded(motion.hold)
    except RcpError as failed:
        if not isinstance(error, DeviceTimeout):
            raise DeviceTimeout(
                f"{error}, which it has not confirmed: {failed}", details=error.details
            ) from error
