"""Rigid transforms, polygons and the WGS 84 ellipsoid: pure functions that import nothing of the gateway."""

from __future__ import annotations

from rcp_geometry.earth import NED, ecef, geodetic, heading, local
from rcp_geometry.polygon import Corner, Polygon
from rcp_geometry.rigid import IDENTITY, Rigid, about_z

__all__ = [
    "IDENTITY",
    "NED",
    "Corner",
    "Polygon",
    "Rigid",
    "about_z",
    "ecef",
    "geodetic",
    "heading",
    "local",
]
