"""An ADS-B receiver on board, and the aircraft that it hears."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from rcp_mavlink_sim.wire import mav

__all__ = ["AdsbReceiver", "Sighting"]

_PAUSE = 1.0  # s between two lists, as in ArduPilot


class Sighting(msgspec.Struct):
    """One aircraft, as it tells of itself."""

    address: int
    callsign: str
    latitude: float
    longitude: float
    altitude: float
    """Above the sea, m."""
    course: float = 0.0
    """Clockwise from north, rad."""
    speed: float = 0.0
    climb: float = 0.0
    emitter: int = 1
    flags: int = 0b1011_1111
    """ADSB_FLAGS: what of it is valid."""
    squawk: int = 7000


class AdsbReceiver:
    """Tells all aircraft in turns, one a message, and pauses between two lists."""

    def __init__(self) -> None:
        self.aircraft: list[Sighting] = []
        self._left: list[Sighting] = []
        self._began = -math.inf

    def next(self, time: float) -> Any:
        """Return ADSB_VEHICLE of the next aircraft; None if it is no one's turn."""
        if not self._left:
            if time - self._began < _PAUSE or not self.aircraft:
                return None
            self._left, self._began = list(self.aircraft), time
        one = self._left.pop(0)
        return mav.MAVLink_adsb_vehicle_message(
            one.address, round(one.latitude * 1e7), round(one.longitude * 1e7), 1,
            round(one.altitude * 1000), round(math.degrees(one.course) * 100) % 36000,
            round(one.speed * 100), round(one.climb * 100), one.callsign.encode()[:8], one.emitter, 0,
            one.flags, one.squawk,
        )  # fmt: skip
