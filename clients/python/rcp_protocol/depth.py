"""Nesting depth of values, determined without a call per value."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate, count
from operator import sub
from typing import Any

from rcp_protocol.plain import is_list, is_map

__all__ = ["is_deep", "is_deep_json"]

_MAPS_AS_LISTS = bytes.maketrans(b"{}", b"[]")
_DROPPED = bytes(set(range(256)) - set(b'[]{}"'))
_NESTS = frozenset((list, dict))


def is_deep_json(data: bytes, limit: int) -> bool:
    """Return whether JSON is nested deeper than `limit`, by its brackets outside of strings."""
    if b"\\" in data:
        data = data.replace(b"\\\\", b"").replace(b'\\"', b"")
    marks = data.translate(_MAPS_AS_LISTS, _DROPPED)
    if b'"' in marks:
        marks = b"".join(marks.split(b'"')[::2])
    opened = accumulate(map(len, marks.split(b"]")))
    return max(map(sub, opened, count())) > limit


def is_deep(value: Any, limit: int) -> bool:
    """Return whether plain data is nested deeper than `limit`."""
    level: list[Any] = [value]
    for _ in range(limit):
        level = [child for item in level for child in _nests(item)]
        if not level:
            return False
    return True


def _nests(value: Any) -> Iterable[Any]:
    """Return the lists and maps in a list or map; most have none."""
    if is_map(value):
        value = list(value.values())
    if not is_list(value) or _NESTS.isdisjoint(map(type, value)):
        return ()
    return [child for child in value if type(child) in _NESTS]
