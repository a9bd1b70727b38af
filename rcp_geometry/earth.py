"""Places on the WGS 84 ellipsoid, and frames fixed to it.

The frame of the earth has its origin at the centre, z through the north pole and x through longitude
0 (ECEF, the `earth` of REP-105). Altitudes are above the ellipsoid; see docs/frames.md for those above
the sea.
"""

from __future__ import annotations

import math

from rcp_geometry.rigid import Quat, Rigid, Vec, about_z

__all__ = ["NED", "ecef", "geodetic", "heading", "local"]

_A = 6_378_137.0  # m, equatorial radius
_F = 1 / 298.257223563  # flattening
_B = _A * (1 - _F)
_E2 = _F * (2 - _F)  # squares of the eccentricities
_EP2 = _E2 / (1 - _E2)
_ROUNDS = 3  # of Bowring's method: below 1e-9 m from the sea floor to the moon
NED: Quat = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)
"""The axes north, east, down in those east, north, up; and the other way round."""


def ecef(latitude: float, longitude: float, altitude: float) -> Vec:
    """Return a place given in degrees and metres in the frame of the earth."""
    lat, lon = math.radians(latitude), math.radians(longitude)
    s, c = math.sin(lat), math.cos(lat)
    n = _A / math.sqrt(1 - _E2 * s * s)
    flat = (n + altitude) * c
    return flat * math.cos(lon), flat * math.sin(lon), (n * (1 - _E2) + altitude) * s


def geodetic(place: Vec) -> Vec:
    """Return latitude and longitude (deg) and altitude (m) of a place in the frame of the earth."""
    x, y, z = place
    flat = math.hypot(x, y)
    beta = math.atan2(z * _A, flat * _B)  # the parametric latitude
    lat = 0.0
    for _ in range(_ROUNDS):
        lat = math.atan2(z + _EP2 * _B * math.sin(beta) ** 3, flat - _E2 * _A * math.cos(beta) ** 3)
        beta = math.atan2((1 - _F) * math.sin(lat), math.cos(lat))
    s, c = math.sin(lat), math.cos(lat)
    altitude = flat * c + z * s - _A * math.sqrt(1 - _E2 * s * s)
    return math.degrees(lat), math.degrees(math.atan2(y, x)), altitude


def local(latitude: float, longitude: float, altitude: float = 0.0, yaw: float = 0.0) -> Rigid:
    """Return the pose of a local frame on the earth: x east, y north, z up, turned by `yaw` (rad)."""
    # Rz(longitude + 90°) · Rx(90° - latitude): z goes to the zenith, x to the east.
    half = math.radians(90 - latitude) / 2
    upright = Rigid(ecef(latitude, longitude, altitude), about_z(math.radians(longitude + 90)))
    upright = upright._replace(rotation=upright.turn((math.sin(half), 0.0, 0.0, math.cos(half))))
    return upright._replace(rotation=upright.turn(about_z(yaw))) if yaw else upright


def heading(orientation: Quat) -> float:
    """Return the heading (rad, clockwise from north, 0 to 2π) of an orientation in east, north, up."""
    x, y, _ = Rigid((0.0, 0.0, 0.0), orientation).vector((1.0, 0.0, 0.0))
    return math.atan2(x, y) % math.tau
