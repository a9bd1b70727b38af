"""The value that brings an actuator to rest."""

from __future__ import annotations

from typing import Any

from rcp_kernel.tree.entry import Entry

__all__ = ["is_safe", "safe_value"]


def safe_value(entry: Entry) -> Any:
    """Return the value that brings an actuator to rest, in the type of its path."""
    safe = entry.resource.safe
    return entry.value_type.convert(safe) if isinstance(safe, (dict, list)) else safe


def is_safe(entry: Entry, value: Any) -> bool:
    """Return whether a value brings an actuator to rest."""
    return entry.resource.safe is not None and bool(value == safe_value(entry))
