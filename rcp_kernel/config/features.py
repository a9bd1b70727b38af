"""`[features]`: which features a gateway has."""

from __future__ import annotations

from typing import Any

__all__ = ["BUILTIN", "active_features"]

BUILTIN: tuple[str, ...] = (
    "approvals",
    "audit",
    "frames",
    "guard",
    "hubs",
    "inventory",
    "jwt",
    "layouts",
    "leases",
    "logins",
    "motion_limits",
    "places",
    "plans",
    "quotas",
    "tokens",
)
"""The built-in features, active unless set to false in `[features]`."""


def active_features(tables: dict[str, bool | dict[str, Any]]) -> dict[str, dict[str, Any] | None]:
    """Return the tables of the features to load, by name; None where there is none."""
    every: dict[str, bool | dict[str, Any]] = {**dict.fromkeys(BUILTIN, True), **tables}
    return {
        name: None if isinstance(table, bool) else table
        for name, table in sorted(every.items())
        if table is not False
    }
