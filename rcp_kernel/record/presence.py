"""Whether the files of an open database are still where they were opened.

SQLite goes on writing into a file that somebody has deleted or replaced, and nothing of that
would be there at the next start.
"""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["Presence", "StoreGone"]

_NEIGHBOURS = ("-wal", "-shm")


class StoreGone(OSError):
    """The file that is written is not the one that the next start will find."""


class Presence:
    """The files of one database, for the thread that writes it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[Path, os.stat_result] = {path: path.stat()}

    def learn(self) -> None:
        """Take the files beside the database for the right ones: it has just been opened."""
        for suffix in _NEIGHBOURS:
            file = self._path.with_name(self._path.name + suffix)
            if file not in self._known and file.exists():
                self._known[file] = file.stat()

    def forget(self) -> None:
        """Expect other files beside the database: it was closed, which may have deleted them."""
        self._known = {self._path: self._known[self._path]}

    def check(self) -> None:
        """Compare the files with those that were opened.

        :raises StoreGone: one was deleted, replaced or cut.
        """
        for file, known in self._known.items():
            try:
                now = file.stat()
            except FileNotFoundError:
                raise StoreGone(f"{file.name} was deleted while the gateway ran") from None
            if (now.st_dev, now.st_ino) != (known.st_dev, known.st_ino):
                raise StoreGone(f"{file.name} was replaced while the gateway ran")
            if now.st_size < known.st_size:
                raise StoreGone(f"{file.name} was cut while the gateway ran")
            self._known[file] = now
