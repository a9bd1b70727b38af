"""The line of each key and item of a TOML file, which `tomllib` does not give."""

from __future__ import annotations

import tomllib
from bisect import bisect_right
from collections.abc import Iterator

__all__ = ["Place", "line_of", "positions"]

Place = tuple[str | int, ...]
"""The way to a node: keys of tables and indexes of arrays."""

_BLANK = " \t\r\n"
_BARE_END = ",]}\n#"


def positions(text: str) -> dict[Place, int]:
    """Return the line, from 1, at which each node of a valid TOML file begins."""
    return _Scanner(text).scan()


def line_of(place: Place, lines: dict[Place, int]) -> int:
    """Return the line of a node, or of the nearest one around it that has a line."""
    while place not in lines and place:
        place = place[:-1]
    return lines.get(place, 1)


class _Scanner:
    """Reads a file that `tomllib` has accepted, so that no fault of it needs a message."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._starts = [i for i, letter in enumerate(text) if letter == "\n"]
        self._at = 0
        self._lines: dict[Place, int] = {}
        self._last: dict[Place, int] = {}
        """Index of the last element of each array of tables."""

    def scan(self) -> dict[Place, int]:
        """Read the whole file."""
        here: Place = ()
        while self._skip(_BLANK):
            if self._text.startswith("[", self._at):
                here = self._header()
            else:
                self._pair(here)
        return self._lines

    @property
    def _line(self) -> int:
        return bisect_right(self._starts, self._at - 1) + 1

    @property
    def _next(self) -> str:
        return self._text[self._at : self._at + 1]

    def _skip(self, letters: str) -> bool:
        """Skip letters and comments; return whether anything is left."""
        while self._next and (self._next in letters or self._next == "#"):
            if self._next == "#":
                end = self._text.find("\n", self._at)
                self._at = len(self._text) if end < 0 else end
            else:
                self._at += 1
        return bool(self._next)

    def _header(self) -> Place:
        line = self._line
        brackets = 2 if self._text.startswith("[[", self._at) else 1
        self._at += brackets
        steps: list[str | int] = []
        keys = self._keys()
        for depth, key in enumerate(keys, 1):
            steps.append(key)
            here = tuple(steps)
            self._lines.setdefault(here, line)
            if depth == len(keys) and brackets > 1:
                self._last[here] = self._last.get(here, -1) + 1
            if here in self._last:
                steps.append(self._last[here])
        place = tuple(steps)
        self._lines[place] = line
        self._skip(" \t")
        self._at += brackets
        return place

    def _keys(self) -> list[str]:
        """Read a key, which may be dotted, up to what follows it."""
        return list(self._parts())

    def _parts(self) -> Iterator[str]:
        while True:
            self._skip(" \t")
            start = self._at
            if self._next in ('"', "'"):
                self._string()
            else:
                while self._next and self._next not in ".=] \t":
                    self._at += 1
            (key,) = tomllib.loads(f"{self._text[start : self._at]} = 0")
            yield key
            self._skip(" \t")
            if self._next != ".":
                return
            self._at += 1

    def _pair(self, here: Place) -> None:
        line = self._line
        for key in self._keys():
            here = (*here, key)
            self._lines.setdefault(here, line)
        self._at += 1  # =
        self._skip(" \t")
        self._value(here)

    def _value(self, place: Place) -> None:
        self._lines.setdefault(place, self._line)
        if self._next in ('"', "'"):
            self._string()
        elif self._next == "[":
            self._items(place)
        elif self._next == "{":
            self._table(place)
        else:
            while self._next and self._next not in _BARE_END:
                self._at += 1

    def _items(self, place: Place) -> None:
        self._at += 1
        index = 0
        while self._skip(_BLANK + ",") and self._next != "]":
            self._value((*place, index))
            index += 1
        self._at += 1

    def _table(self, place: Place) -> None:
        self._at += 1
        while self._skip(_BLANK + ",") and self._next != "}":
            self._pair(place)
        self._at += 1

    def _string(self) -> None:
        """Skip a string of any of the four kinds."""
        quote = self._next
        if self._text.startswith(quote * 3, self._at):
            quote *= 3
        self._at += len(quote)
        while self._next and not self._text.startswith(quote, self._at):
            self._at += 2 if self._next == "\\" and quote[0] == '"' else 1
        self._at += len(quote)
        while len(quote) > 1 and self._next == quote[0]:  # """" ends with a quote of the text
            self._at += 1
