"""The configuration of `[plugins.dashboard]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["DashboardConfig"]


class DashboardConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits on the dashboard's telemetry."""

    samples: Annotated[int, Meta(ge=16, le=1_000_000)] = 20_000
    """Samples kept per drawn field; 16 bytes each."""
    fields: Annotated[int, Meta(ge=1)] = 64
    """Maximum number of fields per client."""
    all_fields: Annotated[int, Meta(ge=1)] = 512
    """Maximum number of fields of all clients."""
    idle: Annotated[float, Meta(gt=0)] = 30.0
    """s after the last request until a field is no longer recorded."""
    jpeg_quality: Annotated[int, Meta(ge=1, le=100)] = 75
    """Quality of JPEGs converted from raw images."""
    streams: Annotated[int, Meta(ge=1)] = 16
    """Maximum number of camera streams."""
    panels: dict[Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]{1,64}$")], str] = {}
    """Panels of plugins, by name: an installed package, or a folder, with a `/` in its path."""
    tiles: str | None = None
    """Path of a PMTiles archive with the tiles of the map."""
