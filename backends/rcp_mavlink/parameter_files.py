"""Parameter files: `.param` of Mission Planner and MAVProxy, `.params` of QGroundControl."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from fnmatch import fnmatchcase
from typing import NamedTuple

from rcp_mavlink.paramcoding import REAL, bounds

__all__ = ["FORMATS", "Entry", "Fault", "Row", "checked", "is_state", "parsed"]

_APART = re.compile(r"[\s,]+")
_NAME = re.compile(r"[A-Za-z0-9_]{1,16}\Z")
_SHORT, _LONG = 2, 5
"""Columns of a line: name and value; system, component, name, value and type."""
_LARGEST = 3.4e38
"""Of a REAL32."""
_MOST = 10_000  # lines: several times the parameters of any autopilot
_QUOTED = 80
"""Characters of a faulty text that are repeated."""
_STATE = (
    "_HASH_CHECK", "FORMAT_VERSION", "SYSID_SW_MREV", "SYS_NUM_RESETS", "STAT_*", "*_TOTAL", "CMD_INDEX",
    "LOG_LASTFILE", "GND_ABS_PRESS", "GND_TEMP", "BARO*_GND_PRESS",
)  # fmt: skip


class Row(NamedTuple):
    """One parameter of a vehicle."""

    name: str
    value: float
    type: int
    """MAV_PARAM_TYPE."""


class Entry(NamedTuple):
    """One parameter of a file."""

    line: int
    name: str
    value: float


class Fault(NamedTuple):
    """What is wrong with a line."""

    line: int
    reason: str


def is_state(name: str) -> bool:
    """Tell whether the vehicle itself keeps a parameter: a counter, a version, a measurement.

    Written, it would be wrong: with another number of waypoints, the mission is cut off.
    """
    return any(fnmatchcase(name, pattern) for pattern in _STATE)


def parsed(text: str) -> tuple[list[Entry], list[Fault]]:
    """Read a file of either kind; return its entries, and what is wrong with the other lines."""
    found: dict[str, Entry] = {}
    faults: list[Fault] = []
    lines = text.lstrip("\ufeff").splitlines()
    if len(lines) > _MOST:
        return [], [Fault(_MOST + 1, f"a file may have at most {_MOST} lines")]
    for number, line in enumerate(lines, 1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        entry = _entry(number, content)
        if isinstance(entry, Fault):
            faults.append(entry)
            continue
        before = found.setdefault(entry.name, entry)
        if before.value != entry.value:
            faults.append(Fault(number, f"{entry.name} has another value in line {before.line}"))
    if not found and not faults:
        faults.append(Fault(1, "the file has no parameters"))
    return list(found.values()), faults


def _entry(number: int, content: str) -> Entry | Fault:
    columns = _APART.split(content)
    if len(columns) == _LONG:
        columns = columns[2:4]
    if len(columns) != _SHORT:
        return Fault(
            number, "expected NAME,VALUE, or QGroundControl's five columns separated by tabs"
        )
    name, text = columns
    if not _NAME.match(name):
        return Fault(number, f"{name[:_QUOTED]!r} cannot be the name of a parameter")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        return Fault(number, f"{name}: {text[:_QUOTED]!r} is not a number")
    return Entry(number, name, value)


def checked(entries: Iterable[Entry], types: Mapping[str, int]) -> Iterator[Fault]:
    """Tell which entries a vehicle with parameters of these types (MAV_PARAM_TYPE) cannot take."""
    for entry in entries:
        type_ = types.get(entry.name)
        limits = None if type_ is None else bounds(type_)
        if type_ is None:
            yield Fault(entry.line, f"the vehicle has no parameter {entry.name}")
        elif limits is None:
            if abs(entry.value) > _LARGEST:
                yield Fault(entry.line, f"{entry.name}: {entry.value:g} is too large")
        elif not entry.value.is_integer():
            yield Fault(entry.line, f"{entry.name} must be a whole number, and is {entry.value:g}")
        elif not limits[0] <= entry.value <= limits[1]:
            yield Fault(entry.line, f"{entry.name} must be {limits[0]} to {limits[1]}")


def _param(rows: Iterable[Row], _system: int, _component: int) -> str:
    """Write `.param`: name and value of each, separated by a comma."""
    return "".join(f"{row.name},{_number(row)}\n" for row in rows)


def _params(rows: Iterable[Row], system: int, component: int) -> str:
    """Write `.params`: system, component, name, value and type of each, separated by tabs."""
    lines = [f"{system}\t{component}\t{r.name}\t{_number(r)}\t{r.type}\n" for r in rows]
    heading = (
        f"# Onboard parameters for Vehicle {system}\n#\n# Vehicle-Id Component-Id Name Value Type\n"
    )
    return heading + "".join(lines)


FORMATS: Mapping[str, Callable[[Iterable[Row], int, int], str]] = {
    "param": _param,
    "params": _params,
}
"""Writers of a file from parameters, system and component of the vehicle."""


def _number(row: Row) -> str:
    """Write a value with as few digits as tell it from its neighbours."""
    value, type_ = row.value, row.type
    if type_ < REAL and value.is_integer():
        return str(int(value))
    if type_ > REAL or not math.isfinite(value):
        return repr(value)
    wanted = struct.pack("<f", value)
    return next(
        text
        for digits in range(6, 18)
        if struct.pack("<f", float(text := f"{value:.{digits}g}")) == wanted
    )
