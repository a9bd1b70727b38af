"""`rcp_protocol.clock`, under the name that plugins import."""

from __future__ import annotations

from rcp_protocol.clock import (
    iso,
    now,
    parse_time,
)

__all__ = [
    "iso",
    "now",
    "parse_time",
]
