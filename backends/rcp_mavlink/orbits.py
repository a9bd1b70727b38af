"""Circles around a point: DO_ORBIT of PX4, and the mode CIRCLE of an ArduPilot copter."""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import (
    DeviceRejected,
    DeviceTimeout,
    InvalidValue,
    PreconditionFailed,
    RcpError,
)
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_mavlink import enu
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.fences import beyond
from rcp_mavlink.flightmodes import Family
from rcp_mavlink.geo import distance, offset, shifted
from rcp_mavlink.journeys import Journeys, hold_after, holding
from rcp_mavlink.motion import Motion
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.places import fix_of, located
from rcp_mavlink.speeds import SpeedLimit
from rcp_mavlink.vehicle import Fix, Vehicle

__all__ = ["Orbits"]

_ORBIT, _ABSOLUTE = 34, 5
_TO_THE_CENTRE = 0.0  # ORBIT_YAW_BEHAVIOUR
_RADII = (("CIRCLE_RADIUS_M", 1.0), ("CIRCLE_RADIUS", 0.01))
_RATE = "CIRCLE_RATE"  # deg/s, positive clockwise
_FASTEST_RATE = math.radians(90)
_AROUND = 8  # points of the circle that have to be inside the fence
_NEAR = 0.3  # radii by which it may be off the circle and still go round
_AT_THE_CENTRE = 1.0  # m
_NO_HEADING = 65535

Place = tuple[float, float]


class Orbit(Struct, frozen=True, forbid_unknown_fields=True):
    """A circle; without a centre it is ahead of the vehicle."""

    radius: Annotated[float, Meta(ge=1, le=500, extra_json_schema={"unit": "m"})]
    speed: Annotated[float, Meta(gt=0, le=30, extra_json_schema={"unit": "m/s"})] = 2.0
    turns: Annotated[float, Meta(gt=0, le=1000, extra_json_schema={"unit": "1"})] = 1.0
    """How often it goes round; then it holds."""
    clockwise: bool = True
    """As seen from above."""
    position: m.Place | None = None
    """The centre in the map; `z` is the height."""
    latitude: m.Latitude | None = None
    longitude: m.Longitude | None = None
    altitude: m.Over | None = None
    """Above home, m, with latitude and longitude; default: the present height."""


class Orbiting(Struct, frozen=True):
    """How far it has come."""

    turns: Annotated[float, Meta(extra_json_schema={"unit": "1"})]
    distance: m.Left
    """From the centre."""
    altitude: m.Length
    """Above home, m."""


class Orbits:
    """The circles of one vehicle."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: Commands,
        motion: Motion,
        parameters: Parameters,
        limit: SpeedLimit,
        journeys: Journeys,
    ) -> None:
        self._vehicle, self._commands, self._motion = vehicle, commands, motion
        self._parameters, self._limit, self._journeys = parameters, limit, journeys

    def leading(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path that ends what the vehicle does."""
        return {"action/orbit": self.orbit}

    @staticmethod
    def resources(family: Family) -> list[Resource]:
        """List what it serves."""
        if family.kind != "copter" or family.autopilot == "unknown":
            return []
        return [
            Resource(name="action/orbit", description="Go round a point, facing it; completes after the turns, by the reported position, and then holds.", input=Orbit, output=Orbiting, feedback=Orbiting, examples=({"radius": 10.0, "turns": 2}, {"radius": 20.0, "position": {"x": 0.0, "y": 30.0}}), timeout=3600, max_age=30.0)
        ]  # fmt: skip

    async def orbit(self, given: Orbit, progress: Progress) -> Orbiting:
        """Go round a point.

        :raises PreconditionFailed: it is not in the air.
        :raises DeviceRejected: the circle crosses the fence, or something else takes over.
        """
        vehicle, fix = self._vehicle, await located(self._vehicle)
        if not vehicle.armed or vehicle.landed is not False:
            raise PreconditionFailed(
                "orbit: the vehicle is not in the air", remedy="Arm it and take off first."
            )
        centre, altitude = self._centre(given, fix)
        self._check_fence(given.radius, centre, altitude)
        speed = self._limit.kept(given.speed, strictly=False)
        async with holding(self._motion):
            mode = "ORBIT" if vehicle.family.px4 else "CIRCLE"
            if vehicle.family.px4:
                sea = altitude + fix.above_sea - fix.height
                begin = partial(self._begin_orbit, given, centre, sea, speed)
            else:
                await self._set_circle(given, speed)
                if given.position is not None or given.latitude is not None:
                    await self._approach(given, centre, altitude, fix, progress)
                begin = partial(self._motion.to_mode, mode)
            async with self._ending(mode):
                await begin()
                result = await self._follow(given, centre, mode, progress)
                await self._rest()
        return result

    async def _rest(self) -> None:
        """Hold, as after `move_to`: in the mode for the next target or set-point, if it enters that."""
        family = self._vehicle.family
        if not family.px4:  # which holds in the mode for targets
            with suppress(DeviceRejected):
                await self._motion.to_mode(family.guided)
                return
        await self._motion.hold()

    @asynccontextmanager
    async def _ending(self, mode: str) -> AsyncGenerator[None]:
        """Hold if the circle fails but may go on, because an answer was lost for example."""
        before = self._vehicle.mode
        try:
            yield
        except RcpError as error:
            circles = (mode, before) if isinstance(error, DeviceTimeout) else (mode,)
            if self._vehicle.mode in circles and not self._vehicle.lost:
                await hold_after(self._motion, error)
            raise

    def _centre(self, given: Orbit, fix: Fix) -> tuple[Place, float]:
        """Return the centre (deg) and the height above home (m)."""
        if given.position is not None and given.latitude is not None:
            raise InvalidValue("orbit: give `position`, or latitude and longitude, not both")
        if (given.latitude is None) != (given.longitude is None):
            raise InvalidValue("orbit: latitude and longitude must be given together")
        altitude = fix.height if given.altitude is None else given.altitude
        if given.latitude is not None and given.longitude is not None:
            return (given.latitude, given.longitude), altitude
        if given.position is not None:
            home = self._vehicle.home
            if home is None:
                raise PreconditionFailed("orbit: home is not known yet")
            at = given.position
            lat, lon, height = enu.there(at.x, at.y, at.z or 0.0, home)
            return (lat, lon), altitude if at.z is None else height
        heading = self._heading()
        ahead = (given.radius * math.cos(heading), given.radius * math.sin(heading))
        return shifted(*ahead, (fix.lat, fix.lon)), altitude

    def _heading(self) -> float:
        hundredths = self._vehicle.latest["GLOBAL_POSITION_INT"].fields()["hdg"]
        if hundredths == _NO_HEADING:
            raise PreconditionFailed(
                "orbit: the vehicle reports no heading", remedy="Give the centre."
            )
        return math.radians(hundredths / 100)

    def _check_fence(self, radius: float, centre: Place, altitude: float) -> None:
        for n in range(_AROUND):
            angle = n * math.tau / _AROUND
            point = shifted(radius * math.cos(angle), radius * math.sin(angle), centre)
            if (why := beyond(self._vehicle, self._parameters, point, altitude)) is not None:
                raise DeviceRejected(
                    f"orbit: {why}",
                    remedy="Choose a circle inside the fence: see service/fence/download, param/FENCE_*.",
                    details={"fence": why},
                )

    # PX4

    async def _begin_orbit(self, given: Orbit, centre: Place, sea: float, speed: float) -> None:
        radius = given.radius if given.clockwise else -given.radius
        command = Command(
            _ORBIT, (radius, speed, _TO_THE_CENTRE, 0.0), *centre, sea, _ABSOLUTE,
            place=True, whole=True,
        )  # fmt: skip
        await self._commands.send(command, "orbit")
        await self._motion.seen(lambda: self._vehicle.mode == "ORBIT", "orbit")

    # ArduPilot

    async def _set_circle(self, given: Orbit, speed: float) -> None:
        """Set radius and rate, which ArduPilot has as parameters."""
        known = self._parameters.known
        found = next(((name, factor) for name, factor in _RADII if name in known), None)
        if found is None or _RATE not in known:
            raise PreconditionFailed(
                "orbit: the vehicle's parameters of its circle are not known yet",
                remedy="Wait until the parameters are listed: see param/CIRCLE_RATE.",
            )
        rate = min(_FASTEST_RATE, speed / given.radius) * (1 if given.clockwise else -1)
        for name, value in ((found[0], given.radius / found[1]), (_RATE, math.degrees(rate))):
            if known[name].value != value:
                await self._parameters.write(name, value)

    async def _approach(
        self, given: Orbit, centre: Place, altitude: float, fix: Fix, progress: Progress
    ) -> None:
        """Go to the nearest point of the circle and face its centre, which CIRCLE puts ahead."""
        north, east = offset(fix.lat, fix.lon, centre)
        away = math.hypot(north, east)
        angle = math.atan2(east, north) if away > _AT_THE_CENTRE else 0.0
        edge = (given.radius * math.cos(angle), given.radius * math.sin(angle))
        lat, lon = shifted(*edge, centre)
        facing = math.remainder(angle + math.pi, math.tau)
        goal = m.MoveTo(latitude=lat, longitude=lon, altitude=altitude, yaw=facing)
        await self._journeys.move_to(goal, lambda *_, **__: progress(fraction=0.0))

    # Both

    async def _follow(self, given: Orbit, centre: Place, mode: str, progress: Progress) -> Orbiting:
        vehicle = self._vehicle
        turned, before = 0.0, self._angle(centre)
        sense = 1 if given.clockwise else -1
        state = self._state(0.0, centre)

        def report() -> bool:
            nonlocal turned, before, state
            now = self._angle(centre)
            if abs(distance(self._place(), centre) - given.radius) <= _NEAR * given.radius:
                turned += math.remainder(now - before, math.tau) * sense
            before = now
            state = self._state(max(0.0, turned / math.tau), centre)
            progress(state, fraction=min(1.0, state.turns / given.turns))
            return state.turns >= given.turns

        await self._motion.follow(report, "orbit", stays=lambda: vehicle.mode == mode)
        return state

    def _place(self) -> Place:
        fix = fix_of(self._vehicle)
        return fix.lat, fix.lon

    def _angle(self, centre: Place) -> float:
        north, east = offset(*self._place(), centre)
        return math.atan2(east, north)

    def _state(self, turns: float, centre: Place) -> Orbiting:
        return Orbiting(turns, distance(self._place(), centre), fix_of(self._vehicle).height)
