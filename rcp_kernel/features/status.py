"""A feature's part of `/system/status`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

__all__ = ["StatusPart"]


class StatusPart(NamedTuple):
    """A part of the health report."""

    facts: Mapping[str, Any]
    """Items of the report, by the feature's own names."""
    degraded: bool = False
    """Whether something is wrong, so that the gateway as a whole is not `ok`."""
