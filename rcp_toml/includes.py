"""`include`: further files of a configuration, whose tables and lists are added to those of the first."""

from __future__ import annotations

import os
from collections.abc import Iterator
from glob import has_magic
from pathlib import Path
from typing import Any, NamedTuple

from rcp_protocol.errors import ConfigError
from rcp_protocol.plain import is_list, is_map
from rcp_toml.named_file import read_named
from rcp_toml.positions import Place

__all__ = ["Merged", "Part", "included", "merge"]

_LARGEST = 1024 * 1024  # bytes
_MOST = 200  # files of a pattern


class Part(NamedTuple):
    """One included file."""

    source: str
    text: str


def included(raw: dict[str, Any], source: str) -> Iterator[Part]:
    """Yield the files that `include` of a file names, relative to its folder, those of a pattern by name.

    :raises ConfigError: one cannot be read.
    """
    names = raw.get("include")
    for name in names if is_list(names) else ():
        if not isinstance(name, str):
            continue  # the type of the key says so
        folder = Path(source).parent
        for path in _named(name, folder):
            if os.path.isdir(path):  # noqa: PTH112 - it raises where one may not look
                raise ConfigError(f"`include`: {path} is a folder: write '{path / '*.toml'}'")
            if path.absolute() == Path(source).absolute():
                raise ConfigError(f"`include`: {path} is this file itself: take it out")
            try:
                text = read_named(str(path), folder, _LARGEST)
            except ConfigError as error:
                raise ConfigError(f"`include`: {path} cannot be read: {error}") from None
            yield Part(str(path), text)


def _named(name: str, folder: Path) -> list[Path]:
    """Return the files of a name or pattern.

    :raises ConfigError: the pattern would search whole trees, names too many, or is none.
    """
    parent, _, last = name.rpartition("/")
    try:
        where = folder / Path(parent or ("/" if name.startswith("/") else ".")).expanduser()
        if not has_magic(name):
            return [where / last]
        if has_magic(parent) or "**" in last:
            raise ConfigError(
                f"`include`: in {name!r} a `*` may be only in the name of a file, once in a row"
            )
        found = sorted(where.glob(last))
    except (OSError, RuntimeError, ValueError) as error:
        raise ConfigError(f"`include`: {name!r} names no files: {error}") from None
    if len(found) > _MOST:
        raise ConfigError(f"`include`: {name!r} names {len(found)} files, at most {_MOST} are read")
    return found


class Merged:
    """What became of a file that was added: keys that were there, and where its list items went."""

    def __init__(self) -> None:
        self.conflicts: list[Place] = []
        self._shifts: dict[Place, int] = {}

    def place(self, place: Place) -> Place:
        """Return the place, in the whole, of a node of the added file."""
        for end, step in enumerate(place):
            if isinstance(step, int) and (shift := self._shifts.get(place[:end])):
                return (*place[:end], step + shift, *place[end + 1 :])
        return place

    def add(self, base: dict[str, Any], more: dict[str, Any], place: Place = ()) -> None:
        """Add a file's tables to others: tables join, lists are appended, and anything else conflicts."""
        for key, item in more.items():
            at = (*place, key)
            here = base.get(key)
            if key not in base:
                base[key] = item
            elif is_map(here) and is_map(item):
                self.add(here, item, at)
            elif is_list(here) and is_list(item):
                self._shifts[at] = len(here)
                here.extend(item)
            else:
                self.conflicts.append(at)


def merge(base: dict[str, Any], more: dict[str, Any], source: str) -> Merged:
    """Add a file to those before it.

    :raises ConfigError: it includes others itself.
    """
    if "include" in more:
        raise ConfigError(f"`include`: {source} has one too: name all files in the first one")
    found = Merged()
    found.add(base, more)
    return found
