"""Aircraft nearby, as the receiver on board hears them (ADS-B)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from rcp_kernel.model import Resource
from rcp_kernel.types import LinearVelocity
from rcp_mavlink import messages as m
from rcp_mavlink.dialect import Dialect
from rcp_mavlink.frames import Frame

__all__ = ["TRAFFIC", "Traffic"]

TRAFFIC = "sensor/traffic"
_ADSB = "ADSB_VEHICLE"
_RATE = 5.0  # Hz: ArduPilot sends one aircraft a message
_REMEMBERED = 30.0  # s after which an aircraft that is not heard is left out, as on ground stations
_MOST = 200  # aircraft
_COORDINATES, _ALTITUDE, _HEADING, _VELOCITY, _CALLSIGN, _SQUAWK, _VERTICAL = (
    1,
    2,
    4,
    8,
    16,
    32,
    128,
)
_KINDS = {
    1: "light", 2: "small", 3: "large", 4: "high_vortex_large", 5: "heavy", 6: "highly_manoeuvrable",
    7: "rotorcraft", 9: "glider", 10: "lighter_than_air", 11: "parachutist", 12: "ultralight",
    14: "uav", 15: "space", 17: "emergency_surface", 18: "service_surface", 19: "obstacle",
}  # fmt: skip
"""By ADSB_EMITTER_TYPE."""


class Aircraft(Struct, frozen=True):
    """One aircraft; what it does not tell is null."""

    id: str
    """Its ICAO address, in hexadecimal digits."""
    callsign: str | None
    kind: str
    latitude: m.Degrees | None
    longitude: m.Degrees | None
    altitude: m.Length | None
    """Above the sea, m, by `altitude_by`."""
    altitude_by: Literal["pressure", "satellites"]
    """By pressure it is that of a standard atmosphere, and may differ from the vehicle's by 100 m and more."""
    velocity: LinearVelocity | None
    """East, north and up; up is 0 where only the ground speed is told."""
    squawk: str | None
    age: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})]
    """Since its position was heard."""


class Traffic:
    """The aircraft that one vehicle hears."""

    heeded = frozenset({246})
    """The messages handled here: ADSB_VEHICLE."""

    def __init__(self, publish: Callable[[str, Any], None]) -> None:
        self._publish = publish
        self._heard: dict[int, tuple[float, dict[str, Any]]] = {}
        """By ICAO address: when, and the fields of the message."""
        self._told = True  # also that there is none, at first

    @staticmethod
    def resources(dialect: Dialect) -> list[Resource]:
        """List what it serves."""
        if _ADSB not in dialect.by_name:
            return []
        return [
            Resource(name=TRAFFIC, description="Aircraft nearby that the vehicle's ADS-B receiver hears, for at most 30 s after the last message.", value=list[Aircraft], live=True, native=_ADSB, meta={"message": _ADSB}),
        ]  # fmt: skip

    @staticmethod
    def base(dialect: Dialect) -> dict[str, float]:
        """Return the rates of the messages that it always needs, Hz."""
        return {_ADSB: _RATE} if _ADSB in dialect.by_name else {}

    def frame(self, frame: Frame) -> None:
        """Take one aircraft."""
        fields = frame.fields()
        self._heard.pop(fields["ICAO_address"], None)
        self._heard[fields["ICAO_address"]] = (time.monotonic() - fields["tslc"], fields)
        if len(self._heard) > _MOST:
            del self._heard[next(iter(self._heard))]

    def poll(self) -> None:
        """Publish once a second while there is something to tell, and once that there is nothing left."""
        found = self.value()
        if found or self._told:
            self._publish(TRAFFIC, found)
        self._told = bool(found)

    def value(self) -> list[Aircraft]:
        """Return those that were heard lately, the latest first."""
        now = time.monotonic()
        self._heard = {
            number: (at, fields)
            for number, (at, fields) in self._heard.items()
            if now - at < _REMEMBERED
        }
        latest = sorted(self._heard.values(), key=lambda heard: -heard[0])
        return [_aircraft(fields, max(0.0, now - at)) for at, fields in latest]


def _aircraft(f: dict[str, Any], age: float) -> Aircraft:
    flags = f["flags"]
    placed = flags & _COORDINATES
    return Aircraft(
        id=f"{f['ICAO_address']:06x}",
        callsign=_text(f["callsign"]) if flags & _CALLSIGN else None,
        kind=_KINDS.get(f["emitter_type"], "unknown"),
        latitude=f["lat"] / 1e7 if placed else None,
        longitude=f["lon"] / 1e7 if placed else None,
        altitude=f["altitude"] / 1e3 if flags & _ALTITUDE else None,
        altitude_by="satellites" if f["altitude_type"] else "pressure",
        velocity=_velocity(f) if flags & _VELOCITY and flags & _HEADING else None,
        squawk=f"{f['squawk']:04d}" if flags & _SQUAWK else None,
        age=age,
    )


def _velocity(f: dict[str, Any]) -> LinearVelocity:
    course, speed = math.radians(f["heading"] / 100), f["hor_velocity"] / 100
    up = f["ver_velocity"] / 100 if f["flags"] & _VERTICAL else 0.0
    return LinearVelocity(speed * math.sin(course), speed * math.cos(course), up)


def _text(raw: bytes) -> str | None:
    return raw.split(b"\0", 1)[0].decode("ascii", "replace").strip() or None
