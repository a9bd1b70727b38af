"""Limits of a vehicle that follows, wherever its target goes: its speed limit and its fence."""

from __future__ import annotations

import math
import time
from contextlib import suppress

from rcp_kernel.errors import DeviceRejected, PreconditionFailed
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.enclosure import Enclosure, ahead
from rcp_mavlink.fences import beyond, has_areas, is_united, unknown
from rcp_mavlink.geo import shifted
from rcp_mavlink.pace import Pace
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.plans import FENCE, Plans
from rcp_mavlink.speeds import SpeedLimit
from rcp_mavlink.vehicle import Vehicle
from rcp_protocol.timeouts import timeout

__all__ = ["FollowLimits", "LimitWatch"]

_CHANGE_SPEED, _GROUND_SPEED = 178, 1.0
_LISTING = 5.0  # s for parameters that are not listed yet
_UNTIL_IT_BRAKES = 0.75  # s after its position was measured: the checks' period, and the command
_BRAKING, _VERTICALLY = 2.5, 1.0  # m/s2
_STANDING = 0.2  # m/s below which it goes nowhere
_CHANGED = "Follow again with action/follow, which reads the fence as it is now."
_FENCED = "Fly back with action/move_to, and follow something inside the fence: see service/fence/download, param/FENCE_* or param/GF_*."


class LimitWatch:
    """What limits one vehicle while it follows."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: Commands,
        parameters: Parameters,
        limit: SpeedLimit,
        enclosure: Enclosure | None,
    ) -> None:
        self._vehicle, self._commands, self._parameters = vehicle, commands, parameters
        self._limit, self._enclosure = limit, enclosure
        self.speed = limit.usual
        """The speed limit, m/s; None if it has none."""
        self._pace = Pace(vehicle, self.speed, None)
        self.fault: str | None = None
        """Why it must not go on."""
        self._remedy: str | None = None
        self._fence: str | None = None
        """The fence that is the reason."""

    def check(self) -> None:
        """See whether it keeps to its limits, and could still stop inside its fence; a fault stays."""
        if self.fault is not None:
            return
        self._pace.update(there=False)
        self.fault, self._remedy = self._pace.fault, None
        if (why := self._unread()) is not None:
            self.fault, self._remedy = why, _CHANGED
        elif (why := self._left()) is not None:
            self.fault, self._remedy, self._fence = f"the target leads on: {why}", _FENCED, why

    def refuse(self) -> None:
        """Refuse to follow from outside the fence.

        :raises DeviceRejected: it is there.
        """
        if (why := self._left()) is not None:
            raise DeviceRejected(f"follow: {why}", remedy=_FENCED, details={"fence": why})

    def failure(self, error: DeviceRejected) -> DeviceRejected:
        """Return the error for a fault."""
        more = {} if self._fence is None else {"fence": self._fence}
        return DeviceRejected(
            f"follow: {self.fault}; the vehicle was commanded to hold",
            remedy=self._remedy,
            details={**(error.details or {}), **more},
        )

    async def keep_limit(self) -> None:
        """Keep to a changed speed limit; PX4 reads its parameter all the time.

        :raises RcpError: the vehicle does not change its speed.
        """
        usual = self._limit.usual
        if usual == self.speed:
            return
        self.speed = usual
        self._pace.request(usual)
        if usual is not None and not self._vehicle.family.px4:
            command = Command(_CHANGE_SPEED, (_GROUND_SPEED, usual, -1.0, 0.0))
            await self._commands.send(command, f"follow: speed {usual:g} m/s")

    def _left(self) -> str | None:
        """Describe the fence that it cannot stop before, or has left."""
        fix = self._vehicle.fix
        if fix is None:  # the action ends by itself when it has been without one for long
            return None
        f = self._vehicle.latest["GLOBAL_POSITION_INT"].fields()
        north, east, down = (f[name] / 100 for name in ("vx", "vy", "vz"))
        speed = (north * north + east * east) ** 0.5
        fastest = math.inf if self.speed is None else self.speed
        age = time.monotonic() - self._vehicle.measured_at["GLOBAL_POSITION_INT"]
        until = _UNTIL_IT_BRAKES + max(0.0, age)
        left = ahead(speed, fastest, until, _BRAKING)
        seconds = left / speed if speed > _STANDING else 0.0
        place = shifted(north * seconds, east * seconds, (fix.lat, fix.lon))
        height = fix.height - (ahead(down, abs(down), until, _VERTICALLY) if down else 0.0)
        return self._violated(place, height)

    def _unread(self) -> str | None:
        """Describe what has come to be of the fence since it was read, so that nobody can say what is inside."""
        vehicle, parameters = self._vehicle, self._parameters
        if (what := unknown(vehicle, parameters)) is not None:
            return f"its fence has changed meanwhile, and {what} is not known"
        if self._enclosure is None and has_areas(vehicle, parameters):
            return "its fence was enabled meanwhile, and its areas are not known"
        return None

    def _violated(self, place: tuple[float, float], height: float) -> str | None:
        """Describe the fence that a place (deg) or height (m) violates."""
        vehicle, parameters = self._vehicle, self._parameters
        why = beyond(vehicle, parameters, place, height, warns=True)
        if why is not None or self._enclosure is None or not has_areas(vehicle, parameters):
            return why
        return self._enclosure.left(place)


class FollowLimits:
    """The limits of one vehicle."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: Commands,
        parameters: Parameters,
        limit: SpeedLimit,
        plans: Plans,
    ) -> None:
        self._vehicle, self._commands, self._parameters = vehicle, commands, parameters
        self._limit, self._plans = limit, plans

    async def watch(self) -> LimitWatch:
        """Read the fence, and begin to watch.

        :raises PreconditionFailed: its parameters are not listed yet, or the fence is damaged.
        :raises RcpError: the fence cannot be read, or the vehicle is outside it.
        """
        vehicle, parameters, enclosure = self._vehicle, self._parameters, None
        await self._check_known()
        if has_areas(vehicle, parameters):
            items = await self._plans.download(FENCE)
            try:
                enclosure = Enclosure(items, union=is_united(vehicle, parameters))
            except ValueError as error:
                raise PreconditionFailed(
                    f"follow: an area of the fence on board {error}",
                    remedy="Upload the fence anew: see service/fence/download.",
                ) from None
        watch = LimitWatch(vehicle, self._commands, parameters, self._limit, enclosure)
        watch.refuse()
        return watch

    async def _check_known(self) -> None:
        """Have the parameters of the fence listed.

        :raises PreconditionFailed: some of them are not known.
        """
        parameters = self._parameters
        with suppress(TimeoutError):
            async with timeout(_LISTING):
                await parameters.list()
        if not parameters.complete.is_set():
            raise PreconditionFailed(
                "follow: the vehicle's parameters are not listed yet, so its fence is not known",
                remedy="Try again in a while: on a slow link, their list takes some minutes.",
            )
        if (what := unknown(self._vehicle, parameters)) is not None:
            raise PreconditionFailed(
                f"follow: {what} is not known, so it may be outside its fence",
                remedy="Wait until the vehicle has reported it; check it with a ground station.",
            )
