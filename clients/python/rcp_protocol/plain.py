"""Type guards for plain data, so that what came off the wire is not of unknown type."""

from __future__ import annotations

from typing import Any, TypeGuard

__all__ = ["is_index", "is_list", "is_map", "is_sequence"]


def is_map(value: Any) -> TypeGuard[dict[str, Any]]:
    """Tell whether plain data is an object."""
    return isinstance(value, dict)


def is_list(value: Any) -> TypeGuard[list[Any]]:
    """Tell whether plain data is an array."""
    return isinstance(value, list)


def is_index(text: str) -> bool:
    """Tell whether a field's name is a place in a list, one that `int` reads at once."""
    return len(text) < 10 and text.isdecimal()


def is_sequence(value: Any) -> TypeGuard[list[Any] | tuple[Any, ...]]:
    """Tell whether a value is a list or a tuple."""
    return isinstance(value, (list, tuple))
