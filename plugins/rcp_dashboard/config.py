"""The table `[plugins.dashboard]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["DashboardConfig"]


class DashboardConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the telemetry may cost."""

    samples: Annotated[int, Meta(ge=16, le=1_000_000)] = 20_000
    """Kept of each field that somebody draws; 16 bytes each."""
    fields: Annotated[int, Meta(ge=1)] = 64
    """That one client may have kept at once."""
    all_fields: Annotated[int, Meta(ge=1)] = 512
    """Of all clients together."""
    idle: Annotated[float, Meta(gt=0)] = 30.0
    """s after the last question until a field is not kept any more."""
    jpeg_quality: Annotated[int, Meta(ge=1, le=100)] = 75
    """Of raw images that become JPEG."""
    streams: Annotated[int, Meta(ge=1)] = 16
    """Camera streams at once."""
    layout_size: Annotated[int, Meta(ge=1024)] = 262_144
    """Bytes of one user's layout."""
    layouts: Annotated[int, Meta(ge=1)] = 1000
    """Users that may have one."""
