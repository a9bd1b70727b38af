"""The configuration of a differential drive."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_can.config_names import Name

__all__ = ["DiffDriveConfig"]

Metres = Annotated[float, Meta(gt=0, le=100, extra_json_schema={"unit": "m"})]


class DiffDriveConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The wheels' motors and the geometry."""

    left: Name
    right: Name
    track: Metres
    """Distance between the wheels."""
    radius: Metres
    """Radius of a wheel."""
    valid_for: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "s"})] = 0.5
    """Validity of a velocity in s, before the dead-man sends zero."""
