"""The settings of a drive as text, a line `name value` for each, and how they are read and written."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import NamedTuple

from rcp_kernel.errors import InvalidValue, OutOfRange

__all__ = [
    "Line",
    "Setting",
    "Settings",
    "check_range",
    "number_of",
    "read_text",
    "refused",
    "same",
    "write_text",
]

_RELATIVE = 1e-6  # drives keep 32-bit floats


class Setting(NamedTuple):
    """What is known of a setting without asking the drive."""

    low: float = -math.inf
    high: float = math.inf
    whole: bool = False
    writable: bool = True
    """Whether this writes it; ids and what the gateway sets itself are not written."""


class Line(NamedTuple):
    """One line of a text."""

    number: int
    name: str
    value: str


class Settings(ABC):
    """The settings of one drive; values are text, because some makes name hundreds of several types."""

    known: Mapping[str, Setting] = {}
    """Those that are known without asking; empty: only the drive knows."""
    step = 0.0
    """How far apart two values may be told that are the same, as some makes tell six decimals."""
    saves = False
    """Whether the drive stores them on command; otherwise it forgets them at a loss of supply."""

    def setting(self, name: str) -> Setting:
        """Return what is known of a setting."""
        return self.known.get(name, Setting())

    async def prepare(self) -> None:  # noqa: B027 - most drives need nothing
        """Check that the drive can be read and written.

        :raises DeviceRejected: its firmware is not known.
        """

    @abstractmethod
    async def read_all(self, tell: Callable[[float], object]) -> dict[str, str]:
        """Read all; `tell` is called with the part that is done."""

    @abstractmethod
    async def read(self, name: str) -> str:
        """Read one."""

    @abstractmethod
    async def write(self, name: str, value: str) -> None:
        """Write one, which is in force at once and not stored."""

    async def save(self) -> None:
        """Store all, if it `saves`; return when the drive has confirmed it."""
        raise NotImplementedError


def read_text(text: str) -> list[Line]:
    """Read a text: a name and a value per line; empty lines and those that begin with `#` are skipped.

    :raises InvalidValue: a line is none, has more than ASCII, or names a setting again.
    """
    found: dict[str, Line] = {}
    for number, raw in enumerate(text.splitlines(), 1):
        words = raw.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) != 2:
            raise refused(number, f"{raw.strip()[:60]!r} is not a name and a value")
        name, value = words
        if not all(word.isascii() and word.isprintable() for word in words):
            raise refused(number, f"{raw.strip()[:60]!a} has characters that no drive takes")
        if name in found:
            raise refused(number, f"'{name}' is in line {found[name].number} too")
        found[name] = Line(number, name, value)
    if not found:
        raise InvalidValue("the text has no settings", details={"pointer": "/text"})
    return list(found.values())


def check_range(line: Line, setting: Setting) -> None:
    """Refuse a value that the setting cannot have.

    :raises InvalidValue: it is no number, or out of bounds.
    """
    if setting == Setting():  # nothing is known of it: the drive decides
        return
    value = number_of(line.value, line.number)
    if setting.whole and not value.is_integer():
        raise refused(line.number, f"{line.name} is a whole number, not {line.value}")
    bounded = (setting.low, setting.high) != (-math.inf, math.inf)
    if bounded and not setting.low <= value <= setting.high:
        raise OutOfRange(
            f"line {line.number}: {line.name} is {setting.low:g} to {setting.high:g}, not {line.value}",
            details={"pointer": "/text", "line": line.number},
            remedy="Nothing was written; correct the line.",
        )


def refused(line: int, text: str) -> InvalidValue:
    """Return the refusal of a line."""
    return InvalidValue(
        f"line {line}: {text}",
        details={"pointer": "/text", "line": line},
        remedy="Nothing was written; correct the line.",
    )


def number_of(value: str, line: int = 0) -> float:
    """Return a value as a number; `nan` is one, as some drives have it for 'none'.

    :raises InvalidValue: it is none.
    """
    try:
        return float(value)
    except ValueError:
        raise refused(line, f"{value!r} is not a number") from None


def same(one: str, other: str, step: float = 0.0) -> bool:
    """Return whether two values are the same, as far as a drive keeps and tells them."""
    if one == other:
        return True
    try:
        a, b = float(one), float(other)
    except ValueError:
        return False
    both = math.isnan(a) and math.isnan(b)
    return both or math.isclose(a, b, rel_tol=_RELATIVE, abs_tol=step)


def write_text(values: Mapping[str, str]) -> str:
    """Return the text of settings."""
    return "".join(f"{name} {value}\n" for name, value in values.items())
