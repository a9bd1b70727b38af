"""Detects that the files of an open database were deleted or replaced.

SQLite keeps writing to a file that was deleted or replaced, and all of that would be missing at
the next start.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

__all__ = ["Presence", "StoreGone"]

_NEIGHBOURS = ("-wal", "-shm")


class StoreGone(OSError):
    """The open file is not the one that the next start will open."""


class Presence:
    """The files of one database; used by its writer thread."""

    def __init__(self, path: Path) -> None:
        self._path = str(path)
        self._known = {self._path: path.stat()}

    def learn(self) -> None:
        """Remember the current files beside the database, right after a write."""
        for suffix in _NEIGHBOURS:
            file = self._path + suffix
            with suppress(FileNotFoundError):
                self._known.setdefault(file, Path(file).stat())

    def forget(self) -> None:
        """Forget the files beside the database: closing it may have deleted them."""
        self._known = {self._path: self._known[self._path]}

    def check(self) -> None:
        """Compare the files with those that were opened.

        :raises StoreGone: a file was deleted, replaced or truncated.
        """
        for file, known in self._known.items():
            try:
                now = Path(file).stat()
            except FileNotFoundError:
                raise _gone(file, "deleted") from None
            if (now.st_dev, now.st_ino) != (known.st_dev, known.st_ino):
                raise _gone(file, "replaced")
            if now.st_size < known.st_size:
                raise _gone(file, "cut")
            self._known[file] = now


def _gone(file: str, what: str) -> StoreGone:
    return StoreGone(f"{Path(file).name} was {what} while the gateway ran")
