"""What a feature says of itself in `/system/status`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

__all__ = ["StatusPart"]


class StatusPart(NamedTuple):
    """A part of the report of health."""

    facts: Mapping[str, Any]
    """Items of the report, by names of the feature's own."""
    degraded: bool = False
    """Whether something is wrong, so that the gateway as a whole is not `ok`."""
