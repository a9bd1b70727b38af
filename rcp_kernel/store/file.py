"""The file of a store: how it is made, opened, proved and locked, and what is said if it cannot be."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Generator, Iterable
from contextlib import closing, contextmanager
from errno import ENOSPC
from pathlib import Path
from typing import Any

import msgspec

from rcp_kernel.errors import ConfigError
from rcp_kernel.store.chain import GENESIS, Head, Row, parse_head

__all__ = [
    "FAULTS",
    "ROWS",
    "HeadFile",
    "anchor_of",
    "beside",
    "create",
    "head_beside",
    "is_damage",
    "lock",
    "looked_at",
    "open_read_only",
    "opened",
    "prove",
    "store_errors",
]

Kept = tuple[str, str, bytes]
"""A row of what is kept by key: its place, its key, its value."""
_SCHEMA = """
CREATE TABLE IF NOT EXISTS kept (
    place TEXT NOT NULL, key TEXT NOT NULL, value BLOB NOT NULL, PRIMARY KEY (place, key)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS audit (
    seq INTEGER PRIMARY KEY, hash BLOB NOT NULL, record BLOB NOT NULL
);
"""
ROWS = (
    "SELECT seq, coalesce(CAST(hash AS BLOB), x''), coalesce(CAST(record AS BLOB), x'') FROM audit"
)
"""Selects rows of the audit, as bytes whatever somebody made of them."""
_NO_ACCESS = (
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_AUTH,
)
_BAD_READ = (
    sqlite3.SQLITE_IOERR_READ,
    sqlite3.SQLITE_IOERR_SHORT_READ,
    getattr(sqlite3, "SQLITE_IOERR_DATA", 8202),
    sqlite3.SQLITE_IOERR_CORRUPTFS,
)
"""The disk does not give back what was written."""
_BOOT = Path("/proc/sys/kernel/random/boot_id")
FAULTS = (sqlite3.Error, UnicodeError)
"""What SQLite raises: also the other where a damaged schema is to be told of."""
_BUSY = 1.0  # s to wait for somebody else's lock on the database


def beside(path: Path) -> Path:
    """Return where the head of the audit is kept a second time."""
    return path.with_name(path.name + ".head")


def head_beside(path: Path) -> Head | None:
    """Return the head of the audit that the last writer left beside a database."""
    return HeadFile(path).read()


class HeadFile:
    """The head of the audit beside a database, and in which run of the machine it was written."""

    def __init__(self, path: Path) -> None:
        self.path = beside(path)
        self._file: int | None = None
        self._last: Head = (0, GENESIS)
        self._boot = _boot()

    def read(self) -> Head | None:
        """Return the head; None if there is none that can be read."""
        try:
            return parse_head(self.path.read_text(encoding="ascii").split()[0])
        except (OSError, ValueError, IndexError):
            return None

    @property
    def of_this_boot(self) -> bool:
        """Whether the machine has run since the head was written, as far as that can be known.

        If not, a power cut may have cost what was committed last.
        """
        try:
            words = self.path.read_text(encoding="ascii").split()
        except (OSError, ValueError):
            return True
        return not self._boot or len(words) < 2 or words[1] == self._boot

    def open(self, head: Head = (0, GENESIS)) -> None:
        """Open it to write, with a head if it is new.

        :raises OSError: it cannot be.
        """
        self._last = self.read() or head
        self._file = os.open(self.path, os.O_CREAT | os.O_WRONLY, 0o600)
        if os.fstat(self._file).st_size == 0:
            self.write(head)
            os.fsync(self._file)  # an empty one would count as damage after a power cut

    def write(self, head: Head) -> None:
        """Replace the head in a file that is open.

        :raises OSError: it cannot be.
        """
        assert self._file is not None
        seq, digest = head
        os.lseek(self._file, 0, os.SEEK_SET)
        os.write(self._file, f"{seq:020d}:{digest.hex()} {self._boot}\n".encode())
        self._last = head

    def stay(self) -> None:
        """Make it anew if somebody has deleted it.

        :raises OSError: that cannot be done.
        """
        if self._file is not None and os.fstat(self._file).st_nlink == 0:
            self.close()
            self.open(self._last)

    def close(self) -> None:
        """Close it."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


def _boot() -> str:
    try:
        return _BOOT.read_text(encoding="ascii").strip()
    except (OSError, ValueError):  # only Linux has one
        return ""


def opened(path: Path) -> sqlite3.Connection:
    """Open a store to write.

    :raises sqlite3.Error: it cannot be.
    """
    base = sqlite3.connect(f"{path.absolute().as_uri()}?mode=rw", uri=True, timeout=_BUSY)
    base.execute("PRAGMA journal_mode=WAL")
    base.execute("PRAGMA synchronous=NORMAL")
    base.executescript(_SCHEMA)
    return base


def looked_at(path: Path, *, in_spite: bool = False) -> sqlite3.Connection:
    """Open a database without changing it; `in_spite` of its length, which tells that it was cut.

    :raises sqlite3.Error: it cannot be.
    """
    base = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=_BUSY)
    if in_spite:
        base.execute("PRAGMA writable_schema = ON")
    return base


def is_damage(error: Exception) -> bool:
    """Tell whether an error is of what the file holds, not of who may open it."""
    if isinstance(error, UnicodeError):
        return True
    if not isinstance(error, sqlite3.Error) or isinstance(error, _Taken):
        return False
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
    passing = (*_NO_ACCESS, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_FULL)
    return code in _BAD_READ or code & 0xFF not in passing


def prove(base: sqlite3.Connection) -> None:
    """Find out whether what survives can be read, and whether anything can be written.

    :raises sqlite3.Error: it cannot.
    """
    [(found,)] = base.execute("PRAGMA quick_check('kept')").fetchmany(1)
    if found != "ok":
        raise sqlite3.DatabaseError(found)
    with base:
        base.execute("INSERT OR REPLACE INTO kept VALUES ('store', 'proof', x'c0')")
        base.execute("DELETE FROM kept WHERE place = 'store'")


def create(path: Path, rows: Iterable[Row] = (), kept: Iterable[Kept] = ()) -> None:
    """Make the database all at once: whoever looks finds it whole or not at all."""
    fresh = path.with_name(path.name + ".new")
    for suffix in ("", "-journal", "-wal", "-shm"):  # of a start that was cut off
        fresh.with_name(fresh.name + suffix).unlink(missing_ok=True)
    _claim(fresh)
    with closing(opened(fresh)) as base, base:
        base.executemany("INSERT INTO audit VALUES (?, ?, ?)", rows)
        base.executemany("INSERT INTO kept VALUES (?, ?, ?)", kept)
    fresh.replace(path)


def _claim(path: Path) -> None:
    """Have a file whose content is nobody else's to read."""
    os.close(os.open(path, os.O_CREAT | os.O_WRONLY, 0o600))


def lock(path: Path) -> sqlite3.Connection:
    """Keep a second gateway from the same store; the system lets go when the process ends."""
    place = path.with_name(path.name + ".lock")
    _claim(place)
    held = sqlite3.connect(place, timeout=0, isolation_level=None)
    try:
        held.execute("BEGIN EXCLUSIVE")
    except sqlite3.Error as error:
        held.close()
        if error.sqlite_errorcode != sqlite3.SQLITE_BUSY:
            raise
        raise _Taken("another gateway is using it") from None
    return held


@contextmanager
def store_errors(path: Path) -> Generator[None]:
    """Have what is wrong with a store said in full.

    :raises ConfigError: with what to do next.
    """
    try:
        yield
    except (OSError, *FAULTS) as error:
        raise ConfigError(
            f"[store] path = '{path}' cannot be opened: {error}. {_remedy(error)}"
        ) from None


class _Taken(sqlite3.OperationalError):
    """Another gateway has the store."""


def _remedy(error: Exception) -> str:
    if isinstance(error, _Taken):
        return "Stop the other gateway, or use another path."
    number = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if number in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return "Close the program that has it open."
    if number == sqlite3.SQLITE_FULL or getattr(error, "errno", None) == ENOSPC:
        return "Free some disk space."
    if isinstance(error, OSError) or number in _NO_ACCESS:
        return "Use a folder that the gateway's user can write to."
    return "Stop the gateway, then run `rcpd store repair`, or `rcpd store restore` with a backup."


def open_read_only(path: Path) -> sqlite3.Connection:
    """Open a store to look at, also while its gateway runs.

    :raises ConfigError: it is not there, or not a store.
    """
    try:
        base = looked_at(path)
        base.execute("SELECT 1 FROM audit LIMIT 1")
    except FAULTS as error:
        advice = "; run `rcpd store check`" if is_damage(error) else ""
        raise ConfigError(f"the store '{path}' cannot be read: {error}{advice}") from None
    return base


def anchor_of(base: sqlite3.Connection) -> Head | None:
    """Return the last record that was deleted, where the chain begins."""
    row = base.execute("SELECT value FROM kept WHERE place = 'audit' AND key = 'anchor'").fetchone()
    if row is None:
        return None
    try:
        kept: Any = msgspec.msgpack.decode(row[0])
        return int(kept["seq"]), bytes(kept["hash"])
    except (msgspec.DecodeError, ValueError, TypeError, KeyError):  # the gap says that it is gone
        return None
