"""Conversion between geographic coordinates and metres around a point, on a flat earth."""

from __future__ import annotations

import math

__all__ = ["METRES_PER_DEGREE", "distance", "offset", "shifted"]

METRES_PER_DEGREE = 111_319.49
"""Metres per degree of latitude, on the sphere that ArduPilot uses."""


def offset(lat: float, lon: float, origin: tuple[float, float]) -> tuple[float, float]:
    """Return the metres north and east from `origin` (deg, deg) to a point."""
    north = (lat - origin[0]) * METRES_PER_DEGREE
    turn = (lon - origin[1] + 180.0) % 360.0 - 180.0
    return north, turn * METRES_PER_DEGREE * math.cos(math.radians(origin[0]))


def shifted(north: float, east: float, origin: tuple[float, float]) -> tuple[float, float]:
    """Return latitude and longitude (deg) of the point at an offset in metres from `origin`."""
    lat = origin[0] + north / METRES_PER_DEGREE
    return lat, origin[1] + east / (METRES_PER_DEGREE * math.cos(math.radians(origin[0])))


def distance(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Return the distance of two points given in degrees, m."""
    return math.hypot(*offset(a[0], a[1], b))
