"""Whether the files of an open database are still where they were opened.

SQLite goes on writing into a file that somebody has deleted or replaced, and nothing of that
would be there at the next start.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

__all__ = ["Presence", "StoreGone"]

_NEIGHBOURS = ("-wal", "-shm")


class StoreGone(OSError):
    """The file that is written is not the one that the next start will find."""


class Presence:
    """The files of one database, for the thread that writes it."""

    def __init__(self, path: Path) -> None:
        self._path = str(path)
        self._known = {self._path: path.stat()}

    def learn(self) -> None:
        """Take the files beside the database for the right ones: it has just been written."""
        for suffix in _NEIGHBOURS:
            file = self._path + suffix
            with suppress(FileNotFoundError):
                self._known.setdefault(file, Path(file).stat())

    def forget(self) -> None:
        """Expect other files beside the database: it was closed, which may have deleted them."""
        self._known = {self._path: self._known[self._path]}

    def check(self) -> None:
        """Compare the files with those that were opened.

        :raises StoreGone: one was deleted, replaced or cut.
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
