"""How long a vehicle has flown in its life, as its parameters count it."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_kernel.errors import UnsupportedOperation
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.vehicle import Vehicle

__all__ = ["FlightStatistics"]

_ARDUPILOT = ("STAT_FLTTIME", "STAT_RUNTIME", "STAT_BOOTCNT")
_PX4 = ("LND_FLIGHT_T_HI", "LND_FLIGHT_T_LO", "COM_FLIGHT_UUID")
_MASK = 0xFFFFFFFF

Seconds = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})]
Times = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]


class Flown(Struct, frozen=True):
    """What a vehicle counts; null where it does not."""

    flight_time: Seconds
    """In the air or, on the ground, driven."""
    run_time: Seconds | None
    """Switched on."""
    boots: Times | None
    flights: Times | None


class FlightStatistics:
    """The counters of one vehicle."""

    def __init__(self, vehicle: Vehicle, parameters: Parameters) -> None:
        self._vehicle, self._parameters = vehicle, parameters

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="service/flight_statistics", meta=READS, description="How long it has flown and run, how often it was started: ArduPilot counts up to half a minute late, PX4 when it disarms.", output=Flown, timeout=15),
        ]  # fmt: skip

    async def read(self, _: None, __: Progress) -> Flown:
        """Read the counters.

        :raises UnsupportedOperation: the vehicle has none.
        """
        names = _PX4 if self._vehicle.family.px4 else _ARDUPILOT
        await self._parameters.complete.wait()
        if names[0] not in self._parameters.known:
            raise UnsupportedOperation("flight_statistics: the vehicle does not count them")
        first, second, third = [await self._read(name) for name in names]
        if self._vehicle.family.px4:
            microseconds = ((first or 0) & _MASK) << 32 | ((second or 0) & _MASK)
            return Flown(microseconds / 1e6, None, None, third)
        return Flown(float(first or 0), None if second is None else float(second), third, None)

    async def _read(self, name: str) -> int | None:
        if name not in self._parameters.known:
            return None
        return round(await self._parameters.read(name))
