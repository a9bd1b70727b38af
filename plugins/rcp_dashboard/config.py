"""The table `[plugins.dashboard]`."""

from __future__ import annotations

import msgspec

__all__ = ["DashboardConfig"]


class DashboardConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Nothing to say yet: `[plugins.dashboard]` alone serves it."""
