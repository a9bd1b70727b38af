"""A place that a gimbal keeps in view (region of interest)."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from rcp_kernel.errors import DeviceTimeout, PreconditionFailed, RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.geo import offset
from rcp_mavlink.gimbal_list import GimbalKey, GimbalList
from rcp_mavlink.gimbals import TURNING, Gimbals, is_close
from rcp_mavlink.places import fix_of
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Region", "Regions"]

_LOOK_AT, _LOOK_AHEAD = 195, 197
_ABSOLUTE = 5
_CLOSE = 0.12  # rad: the vehicle may move and turn meanwhile


class Region(m.ByGimbal, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A place that the camera keeps looking at."""

    latitude: m.Latitude
    longitude: m.Longitude
    altitude: m.Over = 0.0
    """Above home, m."""


class Regions:
    """What the gimbals of one vehicle look at."""

    def __init__(
        self, vehicle: Vehicle, commands: Commands, gimbals: Gimbals, known: GimbalList
    ) -> None:
        self._vehicle, self._commands = vehicle, commands
        self._gimbals, self._list = gimbals, known

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {
            "service/camera/look_at": self.look_at,
            "service/camera/look_ahead": self.look_ahead,
        }

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="service/camera/look_at", moves=True, description="Have a gimbal keep a place in view while the vehicle moves; completes when it is accepted, and with `gimbal` when that gimbal looks there.", input=Region, output=Region, examples=({"latitude": -35.3631, "longitude": 149.1652},), timeout=30, max_age=30.0),
            Resource(name="service/camera/look_ahead", moves=True, description="End `service/camera/look_at`; completes when it is accepted.", input=m.ByGimbal | None, examples=(None, {"gimbal": 1}), timeout=15, max_age=30.0),
        ]  # fmt: skip

    async def look_at(self, given: Region, _: Progress) -> Region:
        """Keep a place in view.

        :raises PreconditionFailed: home is not known, from which its height is given, or there is no position.
        :raises DeviceTimeout: the gimbal that was named does not turn there: ArduPilot turns only its first.
        """
        home = self._vehicle.home
        if home is None:
            raise PreconditionFailed("look_at: home is not known yet")
        key = await self._meant(given)
        command = Command(
            _LOOK_AT, _params(key), x=given.latitude, y=given.longitude, z=home[2] + given.altitude,
            frame=_ABSOLUTE, place=True, whole=True, component=None if key is None else key.manager,
        )  # fmt: skip
        if key is None:
            await self._commands.send(command, "look_at")
            return given
        fix_of(self._vehicle)  # from which it is seen to look there
        async with self._gimbals.seen(key) as looks:
            await self._commands.send(command, "look_at")

            def there() -> bool:
                wanted = self._direction(given, key)
                return bool(looks) and wanted is not None and is_close(looks[0], wanted, _CLOSE)

            if not await self._vehicle.until(there, TURNING):
                with suppress(RcpError):  # another gimbal may have turned instead
                    await self._end(key)
                raise DeviceTimeout(
                    f"look_at: accepted, but gimbal {key.device} does not look there",
                    remedy="Some autopilots turn only their first gimbal to a place: use action/gimbal.",
                )
        return given

    async def look_ahead(self, given: m.ByGimbal | None, _: Progress) -> None:
        """Keep no place in view any more."""
        await self._end(None if given is None else await self._meant(given))

    async def _end(self, key: GimbalKey | None) -> None:
        component = None if key is None else key.manager
        await self._commands.send(
            Command(_LOOK_AHEAD, _params(key), component=component), "look_ahead"
        )

    async def _meant(self, given: m.ByGimbal) -> GimbalKey | None:
        """Return the gimbal that is named; None if none is."""
        if given.gimbal is None and given.manager is None:
            return None
        return await self._list.find(given.gimbal, given.manager)

    def _direction(self, given: Region, key: GimbalKey) -> m.Gimbal | None:
        """Return where it has to point, relative to the vehicle and within its range.

        None: the vehicle has no position any more.
        """
        fix, info = self._vehicle.fix, self._list.information(key)
        if fix is None:
            return None
        north, east = offset(given.latitude, given.longitude, (fix.lat, fix.lon))
        pitch = math.atan2(given.altitude - fix.height, math.hypot(north, east))
        if info["pitch_min"] < info["pitch_max"]:
            pitch = min(info["pitch_max"], max(info["pitch_min"], pitch))
        yaw = math.remainder(math.atan2(east, north) - self._gimbals.heading(), math.tau)
        if info["yaw_min"] < info["yaw_max"]:
            yaw = min(info["yaw_max"], max(info["yaw_min"], yaw))
        return m.Gimbal(pitch, yaw)


def _params(key: GimbalKey | None) -> tuple[float, float, float, float]:
    """Return the parameters of a command: 0 is the gimbal that the vehicle takes for its first."""
    return (0.0 if key is None else float(key.device), 0.0, 0.0, 0.0)
