"""Home, to which the vehicle returns, and the origin of its estimator: set, and confirmed by it."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from msgspec import Struct

from rcp_kernel.errors import DeviceTimeout, InvalidValue, PreconditionFailed, RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress, check_fence
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.geo import distance
from rcp_mavlink.hub import Hub
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Origins"]

_SET_HOME, _HERE = 179, 1.0
_ABSOLUTE = 5
_HOME, _ORIGIN, _SET_ORIGIN = "HOME_POSITION", "GPS_GLOBAL_ORIGIN", "SET_GPS_GLOBAL_ORIGIN"
_CLOSE, _LEVEL = 0.5, 1.0  # m by which what the vehicle reports may differ, across and in height
_ATTEMPTS = 3
_WAIT = 1.0  # s for the vehicle to report it


class HomePlace(Struct, frozen=True, forbid_unknown_fields=True):
    """A place for home; without one, home is where the vehicle is."""

    latitude: m.Latitude | None = None
    longitude: m.Longitude | None = None
    altitude: m.Level | None = None
    """Above the sea, m; default: that of the present home."""


class OriginPlace(Struct, frozen=True, forbid_unknown_fields=True):
    """A place for the estimator's origin."""

    latitude: m.Latitude
    longitude: m.Longitude
    altitude: m.Level
    """Above the sea, m."""


class Geographic(Struct, frozen=True):
    """A place as the vehicle reports it."""

    latitude: m.Degrees
    longitude: m.Degrees
    altitude: m.Length
    """Above the sea, m."""


class Origins:
    """Home and origin of one vehicle."""

    def __init__(
        self, hub: Hub, vehicle: Vehicle, commands: Commands, intervals: Intervals
    ) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._commands, self._intervals = commands, intervals

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {"service/home/set": self.set_home, "service/origin/set": self.set_origin}

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="service/home/set", moves=True, description="Set home, to which the vehicle returns and from which the map is measured; completes when the vehicle reports it.", input=HomePlace | None, output=Geographic, examples=(None, {"latitude": -35.3632621, "longitude": 149.1652374, "altitude": 584.0}), timeout=30, max_age=30.0),
            Resource(name="service/origin/set", moves=True, description="Set the origin of the estimator, for a vehicle without GPS; completes when the vehicle reports it.", input=OriginPlace, output=Geographic, examples=({"latitude": -35.3632621, "longitude": 149.1652374, "altitude": 584.0},), timeout=30, max_age=30.0),
        ]  # fmt: skip

    async def set_home(self, given: HomePlace | None, _: Progress) -> Geographic:
        """Set home.

        :raises DeviceTimeout: the vehicle accepted it, and reports another home.
        """
        given = given or HomePlace()
        if given.latitude is None or given.longitude is None:
            if given != HomePlace():
                raise InvalidValue(
                    "home/set: latitude and longitude must be given together",
                    remedy="Give both, or nothing for the present position.",
                )
            await self._commands.send(Command(_SET_HOME, (_HERE, 0.0, 0.0, 0.0)), "home/set")
            return await self._reported(_HOME, "home/set", None)
        altitude = given.altitude
        if altitude is None:
            if self._vehicle.home is None:
                raise PreconditionFailed(
                    "home/set: the vehicle has no home, so its height is not known",
                    remedy="Give `altitude`, in metres above the sea.",
                )
            altitude = self._vehicle.home[2]
        wanted = Geographic(given.latitude, given.longitude, altitude)
        await self._commands.send(
            Command(
                _SET_HOME, x=wanted.latitude, y=wanted.longitude, z=altitude,
                frame=_ABSOLUTE, place=True, whole=True,
            ),
            "home/set",
        )  # fmt: skip
        return await self._reported(_HOME, "home/set", wanted)

    async def set_origin(self, given: OriginPlace, _: Progress) -> Geographic:
        """Set the estimator's origin; ArduPilot keeps one that it has until it reboots.

        :raises PreconditionFailed: it has another one.
        :raises DeviceTimeout: it does not report the new one.
        """
        wanted = Geographic(given.latitude, given.longitude, given.altitude)
        present = await self._present(_ORIGIN)
        if present is not None and _same(present, wanted):
            return present
        if present is not None and not self._vehicle.family.px4:
            raise PreconditionFailed(
                f"origin/set: the estimator already has its origin, at {present.latitude:.6f}, {present.longitude:.6f}",
                remedy="It is set once after boot: reboot with service/reboot, and set it before the GPS has a fix.",
            )  # fmt: skip
        message = self._hub.dialect.module.MAVLink_set_gps_global_origin_message(
            self._vehicle.system,
            round(wanted.latitude * 1e7),
            round(wanted.longitude * 1e7),
            round(wanted.altitude * 1e3),
        )
        for _attempt in range(_ATTEMPTS):
            check_fence()
            self._hub.send(self._vehicle, message)
            with suppress(DeviceTimeout):
                return await self._reported(_ORIGIN, "origin/set", wanted)
        raise DeviceTimeout("origin/set: the vehicle does not report the new origin")

    async def _present(self, name: str) -> Geographic | None:
        """Return what the vehicle reports now; None if it has none."""
        since = time.monotonic()
        with suppress(RcpError):
            await self._intervals.request(name)
            await self._vehicle.until(
                lambda: self._vehicle.received_at.get(name, float("-inf")) >= since, _WAIT
            )
        self._vehicle.check()
        return (
            self._read(name)
            if self._vehicle.received_at.get(name, float("-inf")) >= since
            else None
        )

    async def _reported(self, name: str, what: str, wanted: Geographic | None) -> Geographic:
        """Return what the vehicle reports from now on.

        :raises DeviceTimeout: it does not report what is wanted.
        """
        since = time.monotonic()

        def holds() -> bool:
            fresh = self._vehicle.received_at.get(name, float("-inf")) >= since
            return fresh and (wanted is None or _same(self._read(name), wanted))

        with suppress(RcpError):
            await self._intervals.request(name)
        if not await self._vehicle.until(holds, _WAIT):
            raise DeviceTimeout(f"{what}: sent, but the vehicle does not report it")
        return self._read(name)

    def _read(self, name: str) -> Geographic:
        f = self._vehicle.latest[name].fields()
        return Geographic(f["latitude"] / 1e7, f["longitude"] / 1e7, f["altitude"] / 1e3)


def _same(a: Geographic, b: Geographic) -> bool:
    apart = distance((a.latitude, a.longitude), (b.latitude, b.longitude))
    return apart <= _CLOSE and abs(a.altitude - b.altitude) <= _LEVEL
