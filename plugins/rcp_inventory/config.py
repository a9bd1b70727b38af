"""The table `[features.inventory]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["InventoryConfig"]


class InventoryConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The settings of the inventory."""

    interval: Annotated[float, Meta(ge=0.1, le=60)] = 0.5
    """Seconds between two updates of a subscription, at least."""
