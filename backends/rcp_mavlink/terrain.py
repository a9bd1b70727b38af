"""The ground below a vehicle as it knows it: a reading, and the height at a place."""

from __future__ import annotations

import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceTimeout, PreconditionFailed, UnsupportedOperation
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.dialect import Dialect
from rcp_mavlink.elevation import Elevation
from rcp_mavlink.flightmodes import Family
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.terrain_feed import TerrainFeed
from rcp_mavlink.vehicle import Vehicle

__all__ = ["TERRAIN", "Terrain", "check_offered"]

TERRAIN = "sensor/terrain"
_REPORT, _REQUEST, _CHECK = "TERRAIN_REPORT", "TERRAIN_REQUEST", "TERRAIN_CHECK"
_ASKING = 1.0  # Hz at which a vehicle may ask for heights
_LOADING, _AGAIN = 8.0, 1.0  # s for heights that were just asked for, and between two looks
_CAPABLE = 512  # MAV_PROTOCOL_CAPABILITY_TERRAIN

Blocks = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]


class TerrainReport(Struct, frozen=True):
    """The ground at a place."""

    latitude: m.Degrees
    longitude: m.Degrees
    ground: m.Length | None
    """Height of the ground above the sea, m; null while the vehicle does not know it."""
    height: m.Length | None
    """Height of the vehicle above that ground, m; null likewise."""
    spacing: m.Length | None
    """Distance of the heights that it knows, m."""
    pending: Blocks
    """Blocks of 4 by 4 heights that it waits for."""
    loaded: Blocks
    """Blocks that it has in its memory."""
    missing: list[str]
    """Tiles that it needs and that the folder `terrain` of the configuration does not have."""


class Spot(Struct, frozen=True, forbid_unknown_fields=True):
    """A place on the ground."""

    latitude: m.Latitude
    longitude: m.Longitude


class Terrain:
    """The ground as one vehicle knows it, and what it is sent of it.

    `start` runs what nobody waits for.
    """

    def __init__(
        self,
        hub: Hub,
        vehicle: Vehicle,
        intervals: Intervals,
        publish: Callable[[str, Any], None],
        elevation: Elevation | None,
        start: Callable[[Coroutine[Any, Any, None]], None],
    ) -> None:
        self._hub, self._vehicle, self._intervals = hub, vehicle, intervals
        self._publish = publish
        self._feed = None if elevation is None else TerrainFeed(hub, vehicle, elevation, start)
        self._checked: set[tuple[int, int]] = set()
        """Places that were asked for, deg * 1e7: reports of them are not of the vehicle's own."""
        self._latest: tuple[float, TerrainReport] | None = None
        self._watchers = 0

    @property
    def heeded(self) -> dict[int, Callable[[Frame], None]]:
        """The handler of each message, by its number."""
        by_name = self._hub.dialect.by_name
        found: dict[int, Callable[[Frame], None]] = {}
        if _REPORT in by_name:
            found[by_name[_REPORT].id] = self._take
        if self._feed is not None and _REQUEST in by_name:
            found[by_name[_REQUEST].id] = self._feed.take
        return found

    @staticmethod
    def resources(dialect: Dialect, family: Family) -> list[Resource]:
        """List what it serves: PX4 knows nothing of the ground."""
        if family.px4 or _REPORT not in dialect.by_name:
            return []
        return [
            Resource(name=TERRAIN, description="The ground below the vehicle, by the heights that it was sent.", value=TerrainReport, native=_REPORT, meta={"message": _REPORT}),
            Resource(name="service/terrain/check", meta=READS, description="Ask the vehicle for the height of the ground at a place; it is null while the vehicle does not know it, and is then asked for.", input=Spot, output=TerrainReport, examples=({"latitude": -35.3631, "longitude": 149.1652},), timeout=30),
        ]  # fmt: skip

    @staticmethod
    def base(dialect: Dialect, family: Family, *, served: bool) -> dict[str, float]:
        """Return the rates of the messages that it always needs, Hz: requests, if they are `served`."""
        wanted = served and not family.px4 and _REQUEST in dialect.by_name
        return {_REQUEST: _ASKING} if wanted else {}

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {"service/terrain/check": self._check}

    # The reading

    def _take(self, frame: Frame) -> None:
        f = frame.fields()
        if (f["lat"], f["lon"]) in self._checked:
            return
        self._latest = (time.monotonic(), self._report(f))
        if self._watchers:
            self._publish(TERRAIN, self._latest[1])

    def _report(self, f: dict[str, Any]) -> TerrainReport:
        """Return what a message says; the heights in one without a spacing mean nothing."""
        known = f["spacing"] > 0
        return TerrainReport(
            latitude=f["lat"] / 1e7,
            longitude=f["lon"] / 1e7,
            ground=f["terrain_height"] if known else None,
            height=f["current_height"] if known else None,
            spacing=float(f["spacing"]) if known else None,
            pending=f["pending"],
            loaded=f["loaded"],
            missing=[] if self._feed is None else self._feed.missing,
        )

    async def read(self) -> TerrainReport:
        """Have the vehicle report now.

        :raises RcpError: it does not have the message.
        :raises DeviceTimeout: no report comes.
        """
        since = time.monotonic()
        await self._intervals.request(_REPORT)
        await self._vehicle.until(lambda: self._came(since), self._hub.config.timeout)
        if self._latest is None or not self._came(since):
            raise DeviceTimeout(f"the vehicle did not send {_REPORT}")
        return self._latest[1]

    def _came(self, since: float) -> bool:
        return self._latest is not None and self._latest[0] >= since

    @asynccontextmanager
    async def watched(self, rate: float) -> AsyncGenerator[None]:
        """Request the report at a rate while entered."""
        release = self._intervals.want(_REPORT, rate)
        self._watchers += 1
        try:
            yield
        finally:
            self._watchers -= 1
            release()

    # Places

    async def _check(self, given: Spot, _: Progress) -> TerrainReport:
        return await self.check(given.latitude, given.longitude)

    async def check(self, lat: float, lon: float) -> TerrainReport:
        """Ask the vehicle for the ground at a place.

        :raises DeviceTimeout: it does not answer.
        """
        make: Any = getattr(self._hub.dialect.module, "MAVLink_terrain_check_message", None)
        if make is None:
            raise UnsupportedOperation(f"the dialect has no {_CHECK}")
        place = (round(lat * 1e7), round(lon * 1e7))
        found: list[dict[str, Any]] = []

        def take(frame: Frame) -> None:
            f = frame.fields()
            if (f["lat"], f["lon"]) == place:
                found.append(f)

        self._checked.add(place)
        config = self._hub.config
        try:
            with self._vehicle.listening(_REPORT, take):
                for _ in range(config.retries + 1):
                    self._hub.send(self._vehicle, make(*place))
                    if await self._vehicle.until(lambda: bool(found), config.timeout):
                        return self._report(found[-1])
        finally:
            self._checked.discard(place)
        raise DeviceTimeout(
            "the vehicle does not answer where the ground is",
            remedy="Set TERRAIN_ENABLE 1 and reboot it; not every vehicle has it.",
        )

    async def above_home(self, lat: float, lon: float, height: float) -> float:
        """Return a height above the ground at a place as one above home, m.

        :raises PreconditionFailed: the vehicle does not know the ground there, or at home.
        """
        home = self._vehicle.home
        if home is None:
            raise PreconditionFailed("home is not known yet")
        end = time.monotonic() + _LOADING
        there, here = await self.check(lat, lon), await self.check(*home[:2])
        while None in (there.ground, here.ground) and time.monotonic() < end:
            await self._vehicle.until(lambda: False, _AGAIN)  # it asks for what it lacks now
            there, here = await self.check(lat, lon), await self.check(*home[:2])
        if there.ground is None or here.ground is None:
            where = "there" if there.ground is None else "at home"
            raise PreconditionFailed(
                f"the vehicle does not know the ground {where}",
                remedy="Look at sensor/terrain: it asks for the heights that it lacks, which come from the "
                "folder `terrain` of the configuration or from another ground station.",
                details={"missing": there.missing, "pending": there.pending},
            )
        return height + there.ground - here.ground


def check_offered(vehicle: Vehicle, what: str) -> None:
    """Check that a vehicle may take heights above the ground.

    :raises UnsupportedOperation: it says that it does not.
    """
    frame = vehicle.latest.get("AUTOPILOT_VERSION")
    if vehicle.family.px4 or (frame is not None and not frame.fields()["capabilities"] & _CAPABLE):
        raise UnsupportedOperation(
            f"{what}: the vehicle takes no heights above the ground",
            remedy="An ArduPilot does with TERRAIN_ENABLE 1; otherwise give heights above home.",
        )
