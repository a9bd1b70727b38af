"""From a value of a resource to parts of a message: what each field is taken from."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

__all__ = [
    "Source",
    "Take",
    "at",
    "beside",
    "constant",
    "constant_list",
    "real",
    "stamp",
    "time_of",
]

_FAR = 2**31 - 1


class Source(NamedTuple):
    """A value as plain data, its time, and the value of the resource beside it."""

    value: Any
    time: dict[str, int]
    beside: Any = None


Take = Callable[[Source], Any]
"""Returns what a field of the message is; None leaves the field as it is."""


def time_of(nanoseconds: int) -> dict[str, int]:
    """Return a time since the epoch as ROS has it."""
    sec, nanosec = divmod(max(0, nanoseconds), 1_000_000_000)
    return {"sec": min(sec, _FAR), "nanosec": nanosec}


def _find(value: Any, names: list[str]) -> Any:
    for name in names:
        value = value.get(name) if isinstance(value, dict) else None  # pyright: ignore[reportUnknownVariableType,reportUnknownMemberType]
    return value  # pyright: ignore[reportUnknownVariableType]


def at(path: str) -> Take:
    """Take a field of the value; `""` is the whole value."""
    names = path.split(".") if path else []
    return lambda source: _find(source.value, names)


def first(*paths: str) -> Take:
    """Take the first field of the value that is there."""
    takes = [at(path) for path in paths]

    def found(source: Source) -> Any:
        return next((v for take in takes if (v := take(source)) is not None), None)

    return found


def beside(path: str) -> Take:
    """Take a field of the value beside it."""
    names = path.split(".")
    return lambda source: _find(source.beside, names)


def real(path: str) -> Take:
    """Take a number that may be unknown: NaN, as ROS has it."""
    take = at(path)

    def found(source: Source) -> Any:
        value = take(source)
        return math.nan if value is None else value

    return found


def constant(value: Any) -> Take:
    """Take what is the same in every message."""
    return lambda _: value


def constant_list(*values: float) -> Take:
    """Take a new list of the same numbers for every message."""
    return lambda _: list(values)


def stamp(source: Source) -> dict[str, int]:
    """Take the time of measurement."""
    return source.time
