"""Conversion to the frames of REP-103 and REP-105: map x east, y north, z up; body forward, left, up."""

from __future__ import annotations

import math
from functools import lru_cache

from rcp_geometry import Rigid, ecef, geodetic, local
from rcp_kernel.types import AngularVelocity, LinearVelocity, Point, Quaternion

__all__ = ["attitude", "flat", "heading", "level_velocity", "place", "rates", "there", "yaw"]

Home = tuple[float, float, float]
"""Latitude, longitude (deg) and altitude (m)."""


def yaw(heading: float) -> float:
    """Return the angle from east, counter-clockwise, of a heading clockwise from north, rad."""
    return math.remainder(math.pi / 2 - heading, math.tau)


def heading(yaw: float) -> float:
    """Return the heading clockwise from north of an angle from east, rad."""
    return math.remainder(math.pi / 2 - yaw, math.tau)


def place(lat: float, lon: float, height: float, home: Home) -> Point:
    """Return the position in the map of a place (deg) at a height above home (m)."""
    _, inwards = _map(home)
    return Point(*inwards.point(ecef(lat, lon, home[2] + height)))


def there(east: float, north: float, up: float, home: Home) -> tuple[float, float, float]:
    """Return latitude, longitude (deg) and height above home (m) of a position in the map."""
    outwards, _ = _map(home)
    lat, lon, altitude = geodetic(outwards.point((east, north, up)))
    return lat, lon, altitude - home[2]


@lru_cache(maxsize=256)
def _map(home: Home) -> tuple[Rigid, Rigid]:
    """Return the pose of the map on the earth, and the reverse."""
    outwards = local(*home)
    return outwards, outwards.inverse


def flat(heading: float) -> Quaternion:
    """Return the orientation in the map of a level body with a heading."""
    half = yaw(heading) / 2
    return Quaternion(z=math.sin(half), w=math.cos(half))


def attitude(roll: float, pitch: float, heading: float) -> Quaternion:
    """Return the orientation in the map of a body: roll right side down, pitch nose up."""
    # Pitch about y left is positive nose down.
    r, p, y = roll / 2, -pitch / 2, yaw(heading) / 2
    cr, sr, cp, sp = math.cos(r), math.sin(r), math.cos(p), math.sin(p)
    cy, sy = math.cos(y), math.sin(y)
    return Quaternion(
        x=sr * cp * cy - cr * sp * sy,
        y=cr * sp * cy + sr * cp * sy,
        z=cr * cp * sy - sr * sp * cy,
        w=cr * cp * cy + sr * sp * sy,
    )


def rates(roll: float, pitch: float, yaw: float) -> AngularVelocity:
    """Return the angular velocity of rates about forward, right and down."""
    return AngularVelocity(roll, -pitch, -yaw)


def level_velocity(north: float, east: float, down: float, heading: float) -> LinearVelocity:
    """Return a velocity as seen from a level body with a heading: ahead, left, up."""
    s, c = math.sin(heading), math.cos(heading)
    return LinearVelocity(north * c + east * s, north * s - east * c, -down)
