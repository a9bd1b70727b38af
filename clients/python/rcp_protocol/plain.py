"""Type guards for plain data from the wire."""

from __future__ import annotations

from typing import Any, TypeGuard

__all__ = ["is_index", "is_list", "is_map", "is_sequence"]


def is_map(value: Any) -> TypeGuard[dict[str, Any]]:
    """Return whether plain data is an object."""
    return isinstance(value, dict)


def is_list(value: Any) -> TypeGuard[list[Any]]:
    """Return whether plain data is an array."""
    return isinstance(value, list)


def is_index(text: str) -> bool:
    """Return whether a field name is a list index that `int` can parse."""
    return len(text) < 10 and text.isdecimal()


def is_sequence(value: Any) -> TypeGuard[list[Any] | tuple[Any, ...]]:
    """Return whether a value is a list or a tuple."""
    return isinstance(value, (list, tuple))
