"""Following a target that moves, in the vehicle's own mode for it."""

from __future__ import annotations

import math
import time
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager, nullcontext
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, PreconditionFailed, RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.flightmodes import Family
from rcp_mavlink.follow_limits import FollowLimits, LimitWatch
from rcp_mavlink.follow_target import FollowTargets, can_follow
from rcp_mavlink.hub import Hub
from rcp_mavlink.journeys import Journeys, hold_after, holding
from rcp_mavlink.motion import Motion
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Follows"]

_MODE = "FOLLOW"
_FIRST = 3.0  # s for the first position
_ENABLE, _SYSTEM, _FARTHEST = "FOLL_ENABLE", "FOLL_SYSID", "FOLL_DIST_MAX"
_RELATIVE_TO_HEADING = 1.0  # FOLL_OFS_TYPE
_LOWEST_PX4 = 8.0  # m, of FLW_TGT_HT


class Side(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the vehicle stays, seen from what it follows."""

    distance: Annotated[float, Meta(ge=1, le=100, extra_json_schema={"unit": "m"})]
    angle: Annotated[float, Meta(ge=-3.1416, le=3.1416, extra_json_schema={"unit": "rad"})] = 3.1416
    """From the direction that the target faces, clockwise; the default is behind it."""
    height: Annotated[float, Meta(ge=0, le=200, extra_json_schema={"unit": "m"})] = 10.0
    """Above the target, for PX4 above home and at least 8 m."""


class Follow(Struct, frozen=True, forbid_unknown_fields=True):
    """What to follow, and how."""

    vehicle: Annotated[str, Meta(min_length=1, max_length=64)] | None = None
    """Name of another vehicle of this backend; default: the positions written to `actuator/follow_target`."""
    side: Side | None = None
    """Default: as the vehicle's parameters say; an ArduPilot without any offset there keeps the present one."""
    seconds: Annotated[float, Meta(gt=0, le=36_000, extra_json_schema={"unit": "s"})] | None = None
    """How long; default: until it is cancelled. Then the vehicle holds."""


class Following(Struct, frozen=True):
    """How it follows."""

    distance: m.Left | None
    """Horizontal distance from the target."""
    age: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})]
    """Since the latest position of the target."""
    limited: str | None = None
    """Why it falls behind: the target is faster than the speed limit."""


class Follows:
    """What one vehicle follows."""

    def __init__(
        self,
        hub: Hub,
        vehicle: Vehicle,
        motion: Motion,
        parameters: Parameters,
        targets: FollowTargets,
        limits: FollowLimits,
        journeys: Journeys,
    ) -> None:
        self._hub, self._vehicle, self._motion = hub, vehicle, motion
        self._parameters, self._targets = parameters, targets
        self._limits, self._journeys = limits, journeys

    def leading(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path that ends what the vehicle does."""
        return {"action/follow": self.follow}

    @staticmethod
    def resources(family: Family) -> list[Resource]:
        """List what it serves."""
        if not can_follow(family):
            return []
        return [
            Resource(name="action/follow", description="Follow a target that moves: another vehicle of this backend, or positions written to `actuator/follow_target`. Completes after `seconds`; if the target is lost, or leads out of the fence, it fails. The vehicle holds then.", input=Follow | None, output=Following, feedback=Following, examples=({"seconds": 60.0}, {"vehicle": "vehicle2", "side": {"distance": 10.0}}), timeout=36_000, max_age=30.0),
            *FollowTargets.resources(),
        ]  # fmt: skip

    async def follow(self, given: Follow | None, progress: Progress) -> Following:
        """Follow a target.

        :raises PreconditionFailed: it is not in the air, its mode is not enabled, or nobody tells where the target is.
        :raises DeviceTimeout: it does not respond, or is not seen to hold at the end.
        :raises DeviceRejected: the target was lost, it is outside its fence or would leave it, moves too
            fast, or something else takes over.
        """
        given = given or Follow()
        vehicle, targets = self._vehicle, self._targets
        if not vehicle.armed or vehicle.landed is not False:
            raise PreconditionFailed(
                "follow: the vehicle is not in the air", remedy="Arm it and take off first."
            )
        other = None if given.vehicle is None else targets.vehicle(given.vehicle)
        with nullcontext() if other is None else targets.relayed(other):
            await vehicle.until(lambda: targets.is_known, 0.0 if other is None else _FIRST)
            if not targets.is_known:
                raise PreconditionFailed(
                    "follow: nobody tells where the target is",
                    remedy="Write actuator/follow_target first, and go on writing it.",
                )
            watch = await self._limits.watch()
            if vehicle.family.px4:
                await self._set_up_px4(given.side)
            else:
                await self._set_up_ardupilot(given.side)
            async with holding(self._motion), self._ending():
                await self._motion.to_mode(_MODE, progress=progress)
                async with self._journeys.limited(watch.keep_limit):
                    result = await self._followed(given.seconds, watch, progress)
                await self._motion.hold()
        return result

    async def _followed(
        self, seconds: float | None, watch: LimitWatch, progress: Progress
    ) -> Following:
        targets, vehicle = self._targets, self._vehicle
        began, farthest = time.monotonic(), self._value(_FARTHEST)
        state = self._state(watch)

        def is_followed() -> bool:
            """Return whether the target is known, and near enough for an ArduPilot to follow it."""
            away = targets.distance()
            return targets.is_known and not (farthest and away is not None and away > farthest)

        def stays() -> bool:
            aloft = vehicle.armed and vehicle.landed is not True
            return aloft and vehicle.mode == _MODE and is_followed() and watch.fault is None

        def report() -> bool:
            nonlocal state
            watch.check()
            state = self._state(watch)
            passed = time.monotonic() - began
            progress(state, fraction=None if seconds is None else min(1.0, passed / seconds))
            return seconds is not None and passed >= seconds and stays()

        try:
            await self._motion.follow(report, "follow", stays)
        except RcpError as error:
            down_now = not vehicle.armed or vehicle.landed is True
            if down_now and isinstance(error, DeviceRejected):
                down = "disarmed" if not vehicle.armed else "on the ground"
                raise DeviceRejected(
                    f"follow: the vehicle is {down}", details=error.details
                ) from error
            if watch.fault is not None and isinstance(error, DeviceRejected):
                raise watch.failure(error) from error
            if is_followed() or isinstance(error, DeviceTimeout):
                raise
            why = "no position of it came in time"
            if targets.is_known:
                why = f"it is farther away than {_FARTHEST}, {farthest:g} m"
            raise DeviceRejected(  # no timeout: nothing is left to be done when the link is restored
                f"follow: the target was lost, {why}; the vehicle was commanded to hold",
                remedy="Go on telling where the target is, and follow again.",
            ) from error
        return state

    def _state(self, watch: LimitWatch) -> Following:
        fast, limit, limited = self._targets.speed(), watch.speed, None
        if limit is not None and fast > limit:
            limited = f"the target moves at {fast:.1f} m/s, the speed limit is {limit:g} m/s"
        return Following(self._targets.distance(), min(1e6, self._targets.age), limited)

    @asynccontextmanager
    async def _ending(self) -> AsyncGenerator[None]:
        """Hold if it fails but may go on following, because an answer was lost for example."""
        before = self._vehicle.mode
        try:
            yield
        except RcpError as error:
            modes = (_MODE, before) if isinstance(error, DeviceTimeout) else (_MODE,)
            if self._vehicle.mode in modes and not self._vehicle.lost:
                await hold_after(self._motion, error)
            raise

    # Parameters

    async def _set_up_ardupilot(self, side: Side | None) -> None:
        """Check that the mode is enabled for targets of this gateway, and set the offset.

        :raises PreconditionFailed: it is not.
        """
        own = self._hub.config.source_system
        if self._value(_ENABLE) != 1:
            raise PreconditionFailed(
                f"follow: {_ENABLE} is not 1",
                remedy=f"Set param/{_ENABLE} to 1 and reboot the vehicle, so that it has its other parameters.",
            )
        # It sets this itself, unannounced, to the first system whose position it hears.
        system = await self._parameters.read(_SYSTEM)
        if system not in (0.0, float(own)):
            raise PreconditionFailed(
                f"follow: the vehicle follows system {system:g} only, {_SYSTEM}",
                remedy=f"Set param/{_SYSTEM} to {own}, the gateway's own; with 0, it follows the first that it hears.",
            )
        if side is not None:
            await self._write("FOLL_OFS_TYPE", _RELATIVE_TO_HEADING)
            await self._write("FOLL_OFS_X", side.distance * math.cos(side.angle))
            await self._write("FOLL_OFS_Y", side.distance * math.sin(side.angle))
            await self._write("FOLL_OFS_Z", -side.height)

    async def _set_up_px4(self, side: Side | None) -> None:
        if side is not None:
            await self._write("FLW_TGT_DST", side.distance)
            await self._write("FLW_TGT_FA", math.degrees(side.angle))
            await self._write("FLW_TGT_HT", max(_LOWEST_PX4, side.height))

    def _value(self, name: str) -> float | None:
        known = self._parameters.known.get(name)
        return None if known is None else known.value

    async def _write(self, name: str, value: float) -> None:
        present = self._value(name)
        if present is None:
            raise PreconditionFailed(
                f"follow: the vehicle's parameter {name} is not known",
                remedy="Wait until the parameters are listed, or leave `side` out.",
            )
        if not math.isclose(present, value, rel_tol=1e-6, abs_tol=1e-6):
            await self._parameters.write(name, value)
