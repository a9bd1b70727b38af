"""The heading and the speed of a flight under way, changed without another target."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from rcp_kernel.errors import (
    DeviceTimeout,
    InvalidValue,
    ModeForbids,
    OutOfRange,
    PreconditionFailed,
)
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.flightmodes import Family
from rcp_mavlink.journeys import holding
from rcp_mavlink.motion import Motion
from rcp_mavlink.speeds import SpeedLimit
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Turns"]

_CHANGE_SPEED, _CONDITION_YAW, _REPOSITION = 178, 115, 192
_KINDS = {"air": 0.0, "ground": 1.0, "climb": 2.0, "descent": 3.0}
_ALIGNED = math.radians(6)
_USUAL_RATE = math.radians(20)  # rad/s, slower than any autopilot's default
_MARGIN = 20.0  # s to turn, beside what the rate needs
_NO_HEADING = 65535


class Turn(Struct, frozen=True, forbid_unknown_fields=True):
    """A heading, or an angle to turn by."""

    heading: Annotated[float, Meta(ge=0, le=6.2832, extra_json_schema={"unit": "rad"})] | None = (
        None
    )
    """Clockwise from north."""
    by: Annotated[float, Meta(ge=-3.1416, le=3.1416, extra_json_schema={"unit": "rad"})] | None = (
        None
    )
    """From the present heading; positive to the left."""
    rate: Annotated[float, Meta(gt=0, le=2, extra_json_schema={"unit": "rad/s"})] | None = None
    """Default: the vehicle's own; PX4 always uses its own."""


class Turned(Struct, frozen=True):
    """The heading as the vehicle reports it."""

    heading: Annotated[float, Meta(extra_json_schema={"unit": "rad"})]
    """Clockwise from north."""


class SpeedChange(Struct, frozen=True, forbid_unknown_fields=True):
    """A speed of the flight under way."""

    speed: Annotated[float, Meta(gt=0, le=100, extra_json_schema={"unit": "m/s"})]
    of: Literal["ground", "air", "climb", "descent"] = "ground"


class Turns:
    """Heading and speed of one vehicle."""

    def __init__(
        self, vehicle: Vehicle, commands: Commands, motion: Motion, limit: SpeedLimit, fastest: float
    ) -> None:  # fmt: skip
        self._vehicle, self._commands, self._motion = vehicle, commands, motion
        self._limit, self._fastest = limit, fastest

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path that is no movement of its own."""
        return {"service/change_speed": self.change_speed}

    def leading(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path that ends what the vehicle does."""
        return {"action/turn": self.turn}

    @staticmethod
    def resources(family: Family) -> list[Resource]:
        """List what it serves."""
        found = [
            Resource(name="service/change_speed", moves=True, description="Change the speed of the flight under way, until the autopilot begins another; completes when the vehicle accepts it.", input=SpeedChange, output=SpeedChange, examples=({"speed": 5.0},), timeout=15, max_age=30.0)
        ]  # fmt: skip
        if family.kind == "copter":
            found.append(
                Resource(name="action/turn", description="Turn to a heading where it is; completes when the vehicle reports it.", input=Turn, output=Turned, feedback=Turned, examples=({"heading": 1.5708}, {"by": 0.5}), timeout=120, max_age=30.0)
            )  # fmt: skip
        return found

    async def change_speed(self, given: SpeedChange, _: Progress) -> SpeedChange:
        """Change a speed.

        :raises OutOfRange: it is above the speed limit.
        :raises PreconditionFailed: PX4 changes only the speeds of travel.
        """
        if self._vehicle.family.px4 and given.of in ("climb", "descent"):
            raise PreconditionFailed(  # it would take the value as the speed of travel
                f"change_speed: PX4 does not change its {given.of}",
                remedy="Give the speed over `ground`, or set the parameter of the vehicle.",
            )
        most = self._limit.kept(self._fastest, strictly=False)
        if given.speed > most:
            raise OutOfRange(
                f"change_speed: {given.speed:g} m/s is above the limit of {most:g} m/s",
                remedy="Give a lower speed, or have param/speed_limit or `max_speed` of the backend raised.",
                details={"pointer": "/speed"},
            )
        command = Command(_CHANGE_SPEED, (_KINDS[given.of], given.speed, -1.0, 0.0))
        await self._commands.send(command, "change_speed")
        return given

    async def turn(self, given: Turn, progress: Progress) -> Turned:
        """Turn to a heading.

        :raises InvalidValue: neither a heading nor an angle is given, or both.
        :raises DeviceTimeout: it does not report the heading in time.
        """
        self._check()
        heading = self._heading()
        if (given.heading is None) == (given.by is None):
            raise InvalidValue("turn: give `heading` or `by`", remedy="Give one of the two.")
        now = heading
        wanted = heading - (given.by or 0.0) if given.heading is None else given.heading
        whole = abs(math.remainder(wanted - heading, math.tau))
        mode, family = self._vehicle.mode, self._vehicle.family

        def there() -> bool:
            nonlocal now
            seen = self._known_heading()
            if seen is None:  # for a moment, without a GPS for example
                return self._vehicle.mode != mode
            now = seen
            left = abs(math.remainder(wanted - now, math.tau))
            progress(Turned(now), fraction=max(0.0, 1 - left / whole) if whole > _ALIGNED else 1.0)
            return left < _ALIGNED or self._vehicle.mode != mode

        async with holding(self._motion):
            await self._commands.send(self._command(wanted % math.tau, given.rate), "turn")
            progress(Turned(heading), fraction=0.0)
            seconds = whole / (given.rate or _USUAL_RATE) + _MARGIN
            done = await self._vehicle.until(there, seconds)
        if self._vehicle.mode != mode:
            raise ModeForbids(f"turn: the vehicle changed to mode {self._vehicle.mode}")
        if not done:
            raise DeviceTimeout(
                f"turn: accepted, but the heading is {now:.2f} rad",
                remedy=f"Check that nothing else steers it in {family.guided}.",
            )
        return Turned(now)

    def _check(self) -> None:
        vehicle, guided = self._vehicle, self._vehicle.family.guided
        if not vehicle.armed or vehicle.landed is not False:
            raise PreconditionFailed(
                "turn: the vehicle is not in the air", remedy="Arm it and take off first."
            )
        if vehicle.mode != guided:
            raise ModeForbids(
                f"turn: in {vehicle.mode} the vehicle does not turn on command",
                remedy=f"Set mode {guided} with action/set_mode.",
            )

    def _command(self, heading: float, rate: float | None) -> Command:
        if self._vehicle.family.px4:  # to nowhere, with a heading
            nan = math.nan
            return Command(_REPOSITION, (-1.0, 1.0, 0.0, heading), nan, nan, nan)
        degrees = math.degrees(rate or 0.0)
        return Command(_CONDITION_YAW, (math.degrees(heading), degrees, 0.0, 0.0))

    def _heading(self) -> float:
        heading = self._known_heading()
        if heading is None:
            raise PreconditionFailed("turn: the vehicle reports no heading")
        return heading

    def _known_heading(self) -> float | None:
        frame = self._vehicle.latest.get("GLOBAL_POSITION_INT")
        hundredths = _NO_HEADING if frame is None else frame.fields()["hdg"]
        return None if hundredths == _NO_HEADING else math.radians(hundredths / 100)
