"""The speed limit of a vehicle: the travel speed in its parameters, and a bound of every command."""

from __future__ import annotations

import math

from rcp_kernel.errors import OutOfRange, UnsupportedOperation
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.vehicle import Vehicle

__all__ = ["SpeedLimit"]

_CRUISE = (("AIRSPEED_CRUISE", 1.0), ("TRIM_ARSPD_CM", 0.01))
_OVER_GROUND = (("WP_SPEED", 1.0), ("CRUISE_SPEED", 1.0))
_HOVERING = (("WPNAV_SPEED", 0.01), ("WP_SPD", 1.0))
_ARDUPILOT = {"rover": _OVER_GROUND, "boat": _OVER_GROUND, "plane": _CRUISE, "vtol": _CRUISE}
_PX4_CRUISE, _PX4_OVER_GROUND = (("FW_AIRSPD_TRIM", 1.0),), (("RO_SPEED_LIM", 1.0),)
_PX4 = {
    "rover": _PX4_OVER_GROUND, "boat": _PX4_OVER_GROUND,
    "plane": _PX4_CRUISE, "vtol": _PX4_CRUISE,
}  # fmt: skip
_PX4_HOVERING = (("MPC_XY_VEL_MAX", 1.0),)
"""Parameters with the travel speed, and the factor to m/s."""
_SLOWEST = 0.2  # m/s, the least that ArduPilot takes
_LEAST = ("AIRSPEED_MIN", "ARSPD_FBW_MIN", "FW_AIRSPD_MIN")
_MOST = ("AIRSPEED_MAX", "ARSPD_FBW_MAX", "FW_AIRSPD_MAX")


class SpeedLimit:
    """The travel speed that one vehicle keeps as a parameter; of a plane it is the airspeed."""

    def __init__(self, vehicle: Vehicle, parameters: Parameters) -> None:
        self._vehicle, self._parameters = vehicle, parameters
        self._written: float | None = None
        """The limit that was set through the gateway, m/s; None: the vehicle has its own."""

    @property
    def usual(self) -> float | None:
        """The travel speed in its parameters, m/s; None if unknown."""
        found = self._parameter()
        return None if found is None else found[2]

    @property
    def airspeeds(self) -> tuple[float, float]:
        """The airspeeds between which a plane can fly, m/s."""
        return self._value(_LEAST) or 0.0, self._value(_MOST) or math.inf

    def _value(self, names: tuple[str, ...]) -> float | None:
        known = (self._parameters.known.get(name) for name in names)
        return next((one.value for one in known if one is not None), None)

    def _names(self) -> tuple[tuple[str, float], ...]:
        family = self._vehicle.family
        if family.px4:
            return _PX4.get(family.kind, _PX4_HOVERING)
        return _ARDUPILOT.get(family.kind, _HOVERING)

    def _parameter(self) -> tuple[str, float, float] | None:
        """Return the parameter in effect, its factor and its value in m/s; 0 leaves it to the next."""
        for name, factor in self._names():
            if value := self._value((name,)):
                return name, factor, value * factor
        return None

    async def read(self) -> float:
        """Return the limit as the vehicle has it, m/s.

        :raises UnsupportedOperation: it has no such parameter.
        """
        own, factor = await self._own()
        value = await self._parameters.read(own) * factor
        return value or self.usual or 0.0

    async def _own(self) -> tuple[str, float]:
        """Return the parameter that sets the limit, and its factor."""
        if not any(name in self._parameters.known for name, _ in self._names()):
            await self._parameters.complete.wait()
        for name, factor in self._names():
            if name in self._parameters.known:
                return name, factor
        raise UnsupportedOperation("the vehicle has no parameter with its travel speed")

    async def write(self, speed: float) -> float:
        """Set the limit; return the one in effect.

        :raises OutOfRange: the vehicle cannot travel that slowly, or a plane that fast.
        """
        name, factor = await self._own()
        least, most = self.airspeeds if self._vehicle.family.circles else (_SLOWEST, math.inf)
        if not least <= speed <= most:
            span = f"at least {least:g}" if math.isinf(most) else f"{least:g} to {most:g}"
            raise OutOfRange(f"the speed limit must be {span} m/s, not {speed:g}")
        value = await self._parameters.write(name, speed / factor)
        self._written = value * factor
        return self._written

    def depends_on(self, parameter: str) -> bool:
        """Return whether a parameter of the vehicle is the limit."""
        return any(parameter == name for name, _ in self._names())

    @property
    def was_set(self) -> bool:
        """Whether the limit was set through the gateway."""
        return self._written is not None

    def kept(self, speed: float, *, strictly: bool) -> float:
        """Return a speed within the limit; `strictly` also if it was not set through the gateway."""
        limit = self.usual if strictly else self._written
        return speed if limit is None else min(speed, limit)
