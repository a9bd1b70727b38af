"""The table `[features.layouts]`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

__all__ = ["LayoutsConfig"]


class LayoutsConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[features.layouts]`."""

    most: Annotated[int, Meta(ge=1, le=10_000)] = 500
    """Maximum number of layouts of one tenant with all its users, and of those of all tenants."""
    of_one: Annotated[int, Meta(ge=1, le=1000)] = 50
    """Maximum number of layouts of one user, or shared in one tenant."""
    size: Annotated[int, Meta(ge=1024, le=1_048_576)] = 65_536
    """Maximum size of a layout, in bytes of JSON."""
