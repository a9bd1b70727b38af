"""The fields of values that passed a hub as those of any other value."""

from __future__ import annotations

from typing import Any, cast

__all__ = ["with_fields"]


class _Fields:
    """A map whose entries are read as attributes."""

    __slots__ = ("_entries",)

    def __init__(self, entries: dict[str, Any]) -> None:
        self._entries = entries

    def __getattr__(self, name: str) -> Any:
        try:
            return with_fields(self._entries[name])
        except KeyError:
            raise AttributeError(f"there is no field '{name}'") from None


def with_fields(value: Any) -> Any:
    """Return a value whose fields can be read as attributes, also if it is plain data."""
    if isinstance(value, dict):
        return _Fields(cast("dict[str, Any]", value))
    if isinstance(value, list):
        items = cast("list[Any]", value)
        return (
            [with_fields(one) for one in items] if items and isinstance(items[0], dict) else items
        )
    return value
