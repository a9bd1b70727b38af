"""`rcp_protocol.plain`, under the name that plugins import."""

from __future__ import annotations

from rcp_protocol.plain import (
    is_index,
    is_list,
    is_map,
    is_sequence,
)

__all__ = [
    "is_index",
    "is_list",
    "is_map",
    "is_sequence",
]
